"""Where pictures and heads lie: axes of unit spread, spreads that foresee another site, and the commands."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from ltm_core.base.errors import ModelError
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.picture_domain import DomainSpace
from ltm_core.vision.picture_domain_io import load_domain, write_domain
from ltm_lab.cli.main import cli
from ltm_lab.training.domain_fit import fit_head_domain, fit_space, held_out_odds


def test_the_network_s_pictures_have_no_mean_and_unit_spread_on_each_axis() -> None:
    rng = np.random.default_rng(3)
    many, few = (rng.normal(m, 1, (n, 12)) @ rng.normal(size=(12, 12)) for n, m in ((200, 0.0), (40, 2.0)))
    space = fit_space(NetworkManifest.find("landscape_lite0"), [many, few], "drawn", axes=5)
    points = [(rows - np.array(space.mean)) @ np.array(space.axes).T for rows in (many, few)]
    weight = np.concatenate([np.full(200, 1 / 400), np.full(40, 1 / 80)])  # each set counts alike
    every = np.concatenate(points)
    np.testing.assert_allclose(weight @ every, 0.0, atol=1e-9)
    np.testing.assert_allclose((weight[:, None] * every).T @ every, np.eye(5), atol=1e-9)
    with pytest.raises(ModelError, match="10 pictures that show land; expected 15"):
        fit_space(NetworkManifest.find("landscape_lite0"), [many[:10]], "drawn", axes=5)


def test_a_spread_is_how_far_another_site_will_lie() -> None:
    """Of many drawn heads of four sites; less what is known of spreads beforehand, which draws them towards 1."""
    rng, spreads = np.random.default_rng(4), []
    for _ in range(300):
        sites = rng.normal(0.0, 0.4, (4, 16))
        domain = fit_head_domain(np.repeat(sites, 2, axis=0), [name for name in "abcd" for _ in range(2)], "axes")
        spreads.append((domain.spread**2 * 4.5 - 0.5) / 4)
    assert domain.sites == 4
    assert np.mean(spreads) == pytest.approx(0.4**2 * (1 + 1 / 4), rel=0.05)  # of one more, about the mean of four


def test_what_is_known_of_one_photo_or_one_site() -> None:
    point = np.ones(16)
    assert fit_head_domain(point[None], ["a"], "axes").spread == 1.0
    near = fit_head_domain(np.array([point, point + 0.1, point - 0.1]), ["a"] * 3, "axes")
    assert (near.sites, near.spread) == (1, pytest.approx(0.39, abs=0.02))
    assert near.log_odds(point) > 0 > near.log_odds(-point)
    assert np.isnan(held_out_odds(point[None], ["a"], "axes")).all()


def test_a_site_like_the_others_is_likelier_than_one_like_the_network_s_own() -> None:
    rng = np.random.default_rng(5)
    points = np.concatenate([rng.normal(2.0, 0.3, (4, 16)), rng.normal(0.0, 0.3, (1, 16))])
    odds = held_out_odds(points, list("abcde"), "axes")
    assert (odds[:4] > 0).all()
    assert odds[4] < 0


def test_a_space_that_was_written_is_read_again(tmp_path: Path) -> None:
    manifest = NetworkManifest.find("landscape_lite0")
    space = load_domain(manifest)
    assert space is not None
    write_domain(tmp_path / "again.yaml", space)
    assert (tmp_path / "again.yaml").read_text() == (manifest.folder / "landscape_lite0_domain.yaml").read_text()
    assert len(space.axes) == 16
    assert len(DomainSpace.model_validate(space.model_dump()).mean) == 2 * manifest.maps[space.map]


@pytest.mark.slow
def test_the_commands_measure_and_choose(tmp_path: Path) -> None:
    """Axes of drawn pictures; a head that says where its photos lie is chosen for such photos, and not for others."""
    rng = np.random.default_rng(6)
    for folder, color in (("own", None), ("pink", (200, 30, 200)), ("green", (60, 110, 40))):
        (tmp_path / folder).mkdir()
        for k in range(48 if folder == "own" else 6):
            photo, labels = np.empty((88, 160, 3), np.uint8), np.full((88, 160), 255, np.uint8)
            photo[:30], photo[30:] = (110, 160, 230), rng.integers(20, 200, 3) if color is None else color
            photo[30:, 80:] = (120, 90, 60)
            noisy = np.clip(photo + rng.normal(0, 12, photo.shape), 0, 255).astype(np.uint8)
            labels[:25], labels[40:, :70], labels[40:, 90:] = 0, 6, 4
            cv2.imwrite(str(tmp_path / folder / f"site{k % 3}_{k}.png"), noisy[..., ::-1])
            if folder == "pink":
                cv2.imwrite(str(tmp_path / folder / f"site{k % 3}_{k}_labels.png"), labels)
    for name in ("landscape_lite0.yaml", "landscape_lite0.onnx"):
        (tmp_path / name).write_bytes((NetworkManifest.find("landscape_lite0").folder / name).read_bytes())
    model, out = ["--model", str(tmp_path / "landscape_lite0.yaml")], tmp_path / "heads" / "pink.yaml"
    run = CliRunner()
    assert run.invoke(cli, ["train", "domains", str(tmp_path / "own"), *model]).exit_code == 0
    taught = run.invoke(cli, ["train", "head", str(tmp_path / "pink"), "--out", str(out), *model])
    assert taught.exit_code == 0, taught.output
    assert "for 6 of 6 photos" in " ".join(taught.output.split())
    folders = [str(tmp_path / name) for name in ("pink", "green")]
    options = [
        "--heads",
        str(out.parent),
        "--json",
        str(tmp_path / "h.json"),
        "--overlays",
        str(tmp_path / "o"),
        *model,
    ]
    assert run.invoke(cli, ["eval", "heads", *folders, *options]).exit_code == 0
    found = json.loads((tmp_path / "h.json").read_text())
    assert found["pink"]["chosen"] == {"pink": 6}
    assert found["green"]["chosen"] == {"landscape": 6}
    sheet = cv2.imread(str(tmp_path / "o" / "green_site1_1_landscape.png"))
    assert sheet.shape[1] == 320
    assert sheet.shape[0] > 88
    assert len(list((tmp_path / "o").glob("pink_*_pink.png"))) == 6
