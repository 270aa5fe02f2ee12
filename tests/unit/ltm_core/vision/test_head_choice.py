"""`label_head: auto`: which head is chosen, that it is steady and alters nothing else, and what cannot be chosen
among."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.networks import COLORS, write_classifier, write_domain_of, write_swapping_head

from ltm_core.base.errors import ModelError
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.life_form import LifeForm
from ltm_core.site.networks import camera_label_errors
from ltm_core.vision.head_choice import HeadChoice
from ltm_core.vision.head_choice_io import heads_to_choose, open_choice
from ltm_core.vision.label_head import LabelHead, read_label_head
from ltm_core.vision.labels import Label
from ltm_core.vision.manifest import AUTO_HEAD, NetworkManifest
from ltm_core.vision.picture_domain import DomainSpace, HeadDomain, land_statistics
from ltm_core.vision.picture_domain_io import load_domain
from ltm_core.vision.segmenter import Segmenter

RED, LIME = (np.full((40, 70, 3), COLORS[name], np.uint8) for name in ("red", "lime"))
"""Pictures of two kinds of place. The network's own are lime; the head `swap` was taught by red ones."""
SKY = np.full((40, 70, 3), COLORS["blue"], np.uint8)


@pytest.fixture
def manifest(tmp_path: Path) -> Path:
    path = write_classifier(tmp_path, maps=True)
    space = write_domain_of(path, [LIME])
    red = _point(space, RED)
    domain = {"axes": space.checksum, "centre": red.tolist(), "spread": 0.5, "sites": 2}
    write_swapping_head(tmp_path / "heads" / "swap.yaml", path, domain=domain)
    return path


def _point(space: DomainSpace, photo: Any) -> Any:
    values = (photo[::2, ::2].astype(np.float32) / 255).transpose(2, 0, 1)
    point = space.point(values, np.ones(photo.shape[:2], bool))
    assert point is not None
    return point


def _auto(manifest: Path) -> Segmenter:
    return Segmenter.open(manifest, head=AUTO_HEAD, heads=manifest.parent / "heads")


def test_each_picture_by_itself_has_the_head_of_its_kind(manifest: Path) -> None:
    """To the bit the labels of who names that head; `landscape` where the network knows such pictures."""
    auto, plain = _auto(manifest), Segmenter.open(manifest)
    swapped = Segmenter.open(manifest, head="swap", heads=manifest.parent / "heads")
    for photo, same in ((RED, swapped), (LIME, plain), (RED, swapped), (SKY, plain)):
        found, expected = auto.segment(photo), same.segment(photo)
        np.testing.assert_array_equal(found.labels, expected.labels)
        np.testing.assert_array_equal(found.confidence, expected.confidence)
    assert (auto.segment(RED).labels == Label.GRASS).all()  # the head calls red what lime is
    assert auto.segment(RED, zoom=2.0).labels[20, 30] == Label.GRASS
    assert auto.name == "colors auto"


def test_what_is_unlike_both_has_the_network_s_own(manifest: Path) -> None:
    space = load_domain(NetworkManifest.load(manifest))
    assert space is not None
    choice = open_choice(NetworkManifest.load(manifest), manifest.parent / "heads")
    (head,) = choice.heads
    assert head.domain is not None
    red = _point(space, RED)
    assert head.domain.log_odds(red) > 0 > head.domain.log_odds(np.zeros_like(red))
    assert head.domain.log_odds(-3 * red) < 0
    assert head.domain.log_odds(4 * red) < 0  # beyond the head's photos, on their side
    with pytest.raises(ModelError, match="axes"):
        head.domain.log_odds(red[:-1])


def test_pictures_of_a_minute_do_not_change_the_head(manifest: Path) -> None:
    """What is chosen is what most of the pictures speak for; labels/info tells it; time that goes back begins anew."""
    auto = _auto(manifest)
    assert auto.choice is not None
    before = auto.described
    assert "auto of 1 heads" in before
    chosen = []
    for second, photo in [(0, RED), (20, LIME), (59, LIME), (60, RED), (120, RED), (180, LIME), (240, RED)]:
        auto.segment(photo, seconds=float(second))
        chosen.append("landscape" if auto.head is None else auto.head.name)
    assert chosen == ["swap"] * 7
    assert auto.described.startswith(before.partition(", never")[0])
    assert "swap" in auto.described
    assert auto.choice.told.startswith("swap (log odds: swap ")
    for minute in range(5, 60):
        auto.segment(LIME, seconds=60.0 * minute)
    assert auto.head is None
    assert auto.described != before
    auto.segment(RED, seconds=10.0)
    assert auto.head is not None
    again = _auto(manifest)
    again.segment(RED, seconds=10.0)
    assert again.described == auto.described


def test_a_head_is_left_only_for_one_that_is_clearly_likelier() -> None:
    choice = HeadChoice(_flat_space(), [_head("near", 1.0), _head("far", 1.2)])
    names = []
    for minute, odds in enumerate([[0.0, 0.3, 0.2], [0.0, 0.3, 0.5], [0.0, 0.3, 0.9], [0.0, -3.0, -3.0]]):
        head = choice.look(np.array(odds), 60.0 * minute)
        names.append("landscape" if head is None else head.name)
    assert names == ["near", "near", "far", "landscape"]
    assert choice.look(None, 400.0) is None  # shows no land: as before
    assert choice.alone(np.array([0.0, 0.11, -1.0])) is choice.heads[0]
    assert choice.alone(np.array([0.0, 0.09, -1.0])) is None  # a head is worse than none on other land
    assert choice.alone(None) is None


def _flat_space() -> DomainSpace:
    return DomainSpace(
        network="n", sha256="0" * 64, map="m", measured_on="nothing", mean=(0.0, 0.0), axes=((1.0, 0.0),)
    )


def _head(name: str, centre: float) -> LabelHead:
    domain = HeadDomain(axes=_flat_space().checksum, centre=(centre,), spread=0.5, sites=2)
    return LabelHead(name, name, {}, np.zeros(2, np.float32), 1.0, domain=domain)


def test_statistics_are_of_land_alone() -> None:
    rng = np.random.default_rng(0)
    values, land = rng.normal(size=(3, 8, 12)).astype(np.float32), np.zeros((16, 24), bool)
    land[8:] = True
    found = land_statistics(values, land)
    assert found is not None
    lower = values[:, 4:].reshape(3, -1)
    np.testing.assert_allclose(found, np.concatenate([lower.mean(axis=1), lower.std(axis=1)]), rtol=1e-4)
    values[:, :4] = 99.0
    np.testing.assert_allclose(land_statistics(values, land), found)
    land[:] = False
    land[0, :5] = True
    assert land_statistics(values, land) is None


def test_what_cannot_be_chosen_is_passed_over_and_told(manifest: Path, tmp_path: Path) -> None:
    heads, network = tmp_path / "heads", NetworkManifest.load(manifest)
    write_swapping_head(heads / "old.yaml", manifest)
    write_swapping_head(heads / "other.yaml", manifest, sha256="1" * 64)
    write_swapping_head(heads / "named.yaml", manifest, by_name=True)
    elsewhere = {"axes": "0" * 12, "centre": [0.0], "spread": 1.0, "sites": 1}
    write_swapping_head(heads / "moved.yaml", manifest, domain=elsewhere)
    taken, passed = heads_to_choose(network, heads)
    assert [path.stem for path in taken] == ["swap"]
    assert {path.stem: reason.partition(";")[0][-20:] for path, reason in passed.items()}.keys() == {
        "old", "other", "moved",
    }  # fmt: skip
    assert "does not say where its photos lie" in passed[heads / "old.yaml"]
    assert "is a label head of network" in passed[heads / "other.yaml"]
    with pytest.raises(ModelError, match="stands for a choice"):
        read_label_head(write_swapping_head(tmp_path / "auto.yaml", manifest), network)


def test_a_network_of_which_nobody_knows_where_pictures_lie_cannot_choose(manifest: Path) -> None:
    file = manifest.with_name("colors_domain.yaml")
    content = yaml.safe_load(file.read_text())
    file.write_text(yaml.safe_dump(content | {"sha256": "1" * 64}))
    with pytest.raises(ModelError, match=r"colors_domain\.yaml: is of network 'colors' with sha256 1111"):
        _auto(manifest)
    file.write_text(yaml.safe_dump(content | {"mean": content["mean"][:-1]}))
    with pytest.raises(ModelError, match="expected the same, even number"):
        _auto(manifest)
    file.unlink()
    with pytest.raises(ModelError, match="ltm-lab train domains"):
        _auto(manifest)


def test_the_map_takes_an_auto_camera_s_labels_to_err_as_all_heads_do(manifest: Path, tmp_path: Path) -> None:
    names = ("sky", "grass", "shrub", "tree", "bare", "water", "built")
    confusion = np.eye(7)
    confusion[2] = [0.0, 0.1, 0.5, 0.4, 0.0, 0.0, 0.0]
    calibration = {"classes": list(names), "confusion": confusion.tolist(), "measured_on": "x", "photographs": 3}
    space = load_domain(NetworkManifest.load(manifest))
    assert space is not None
    domain = {"axes": space.checksum, "centre": [0.0] * len(space.axes), "spread": 0.5, "sites": 2}
    write_swapping_head(tmp_path / "heads" / "swap.yaml", manifest, calibration=calibration, domain=domain)

    cameras = {"a": SimpleNamespace(label_head="auto"), "b": SimpleNamespace(label_head="landscape")}
    fuel = SimpleNamespace(label_errors=None)
    site = SimpleNamespace(fuel=fuel, model=str(manifest), label_heads=tmp_path / "heads", cameras=cameras)
    found = camera_label_errors(site)  # type: ignore[arg-type]
    assert list(found) == ["a"]
    shrub, tree = LifeForm.SHRUB - 1, LifeForm.TREE - 1
    own = LabelErrors.of_model(str(manifest)).shares
    assert found["a"].shares[shrub, tree] == pytest.approx((own[shrub, tree] + 0.4) / 2, abs=1e-6)
    np.testing.assert_allclose(found["a"].shares[shrub].sum(), 1.0)
    assert "one of" in found["a"].source
