from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.evidence_scene import HOUR, LABELS, NOW, TRUSTED, votes

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.label_errors import (
    ALIKE,
    UNMEASURED,
    LabelErrors,
    ReliabilityRecord,
    find_record,
    known_errors,
    labels_digest,
    record_of,
    write_record,
)
from ltm_core.fuel.label_measurement import measure_labels
from ltm_core.fuel.life_form import LifeForm, label_forms
from ltm_core.fuel.prior import FuelPrior
from ltm_core.fuel.rules import FusionRules
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.vision.labels import Label
from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest

SHIPPED = NetworkManifest.find(DEFAULT_MODEL)
CODES = {Label.GRASS: 102, Label.SHRUB: 145, Label.TREE: 165, Label.BARE: 99}


def copy_of(manifest: NetworkManifest, folder: Path, **changes: Any) -> Path:
    """Write a manifest of the same network with other keys; `a.b` is the key b of section a."""
    content = yaml.safe_load((manifest.folder / f"{manifest.name}.yaml").read_text())
    content["file"] = str(manifest.model_file())
    for key, value in changes.items():
        *sections, last = key.split("__")
        inner = content
        for section in sections:
            inner = inner[section]
        inner[last] = value
    path = folder / f"{content['name']}.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.parametrize(
    ("changes", "measured"),
    [
        ({}, True),
        ({"name": "mine"}, True),
        ({"name": "mine", "card": "a few words", "source": "elsewhere", "licence": "MIT"}, True),
        ({"input__scale": 0.003921569}, True),  # 1/255 in fewer digits
        ({"sha256": "0" * 64}, False),  # another file under the shipped name
        ({"mapping": {name: "shrub" if name == "tree" else name for name in SHIPPED.classes}}, False),
        ({"mapping": {name: name for name in SHIPPED.classes if name != "water"}}, False),
        ({"classes": list(SHIPPED.classes[::-1])}, False),
        ({"output__offsets": {"water": 1.0}}, False),
        ({"output__temperature": 2.0}, False),
        ({"input__mean": [0.0, 0.0, 0.0]}, False),
        ({"input__channels": "bgr"}, False),
    ],
)
def test_a_record_belongs_to_labels_and_not_to_a_name(tmp_path: Path, changes: dict[str, Any], measured: bool) -> None:
    errors = known_errors(str(copy_of(SHIPPED, tmp_path, **changes)))
    assert errors.measured == measured
    assert (errors.appearance is None) == (not measured)


def test_the_user_s_record_comes_first_and_a_head_has_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    shares = {form.name.lower(): {form.name.lower(): 1.0} for form in LifeForm}
    record = ReliabilityRecord(
        source="mine", network="x", labels=labels_digest(SHIPPED), site="ridge", shares=shares, correlation=ALIKE
    )
    path = write_record(record)
    assert known_errors(DEFAULT_MODEL).state == "measured on site ridge"
    head = tmp_path / "head.yaml"
    head.write_text("name: oak")
    assert find_record(SHIPPED, head) is None
    path.write_text(path.read_text().replace("source: mine", "sauce: mine"))
    with pytest.raises(ConfigError, match="sauce"):
        known_errors(DEFAULT_MODEL)


@pytest.mark.parametrize(("label", "mixed"), [(Label.GRASS, False), (Label.TREE, True), (Label.WATER, False)])
def test_unmeasured_labels_change_no_cell(label: Label, mixed: bool) -> None:
    """Whatever they say, as surely and as often as may be, from all sides and for days; also of cameras with a label
    head at a site whose network is measured (`mixed`)."""
    grid = GridGeometry(0.0, 360.0, 30.0, 12, 12)
    codes = np.repeat([102, 145, 165, 99, 121, 183], 2)[:, None].repeat(12, axis=1).astype(np.int16)
    cells = list(np.ndindex(grid.shape))
    errors, heads = (TRUSTED, {f"c{view}": UNMEASURED for view in range(6)}) if mixed else (None, None)
    evidence = EvidenceMap(grid, FuelPrior(codes, grid), LABELS, errors=errors, errors_of=heads)
    for second in range(0, 3 * 86400, 12 * 3600):
        for view in range(6):
            columns = (1.0, 0.0, 0.0, 0.0, np.pi / 3 * view + 0.1)
            shown = CellVisibility(*(np.full(len(cells), value, np.float32) for value in columns))
            frame = votes(label, NOW + second, f"c{view}", 5000, cells, 1.0, shown, grid)
            evidence.add(frame)
    layers = evidence.layers()
    assert not layers.changed.any()
    np.testing.assert_array_equal(layers.code, codes)
    assert (layers.evidence > 0).all()


SIDE = 36


def drawn_votes(truth: np.ndarray, confusion: np.ndarray, seed: int) -> list[CellVotes]:
    """Two towers see a slope twice; each cell is given a label of `confusion` [form, label], in nine pixels of ten."""
    grid = GridGeometry(0.0, 30.0 * SIDE, 30.0, SIDE, SIDE)
    rng = np.random.default_rng(seed)
    cells = list(np.ndindex(truth.shape))
    rows, cols = np.array(cells, np.int32).T
    frames = []
    for source, bearing in (("north", np.pi), ("west", np.pi / 2)):
        for second in (0, HOUR):
            told = np.array([rng.choice(4, p=confusion[form - 1]) + 1 for form in truth.ravel()])
            counts = np.full((len(cells), len(LABELS)), 1, np.uint32)
            counts[:, 0], counts[:, 5:] = 0, 0
            counts[np.arange(len(cells)), told] += 26
            columns = (0.3, 5.0, 3.0, 3.0, bearing)
            shown = CellVisibility(*(np.full(len(cells), value, np.float32) for value in columns))
            z, sure = np.zeros(len(cells), np.float32), np.full(len(cells), 0.8, np.float32)
            stamp = (NOW + second) * 10**9
            frames.append(CellVotes(grid, rows, cols, counts, z, stamp, source, sure, shown))
    return frames


def landscape(changed: slice) -> tuple[np.ndarray, np.ndarray]:
    """Return the true forms of a slope in four stripes, and its prior codes, which miss that a part became forest."""
    truth = np.repeat(np.arange(1, 5, dtype=np.uint8), SIDE // 4)[:, None].repeat(SIDE, axis=1)
    codes = np.array([0, *CODES.values()], np.int16)[truth]
    truth[changed, changed] = LifeForm.TREE
    return truth, codes


RIGHT = 0.85 * np.eye(4) + 0.0375
SWAPPED = RIGHT[:, [0, 2, 1, 3]]  # calls trees shrubs, and shrubs trees


@pytest.mark.parametrize("confusion", [RIGHT, SWAPPED], ids=["right", "swapped"])
def test_a_measured_network_finds_what_has_changed(confusion: np.ndarray) -> None:
    """By the prior map alone, which calls the new forest shrubs; also of a network that takes one for the other."""
    truth, codes = landscape(slice(10, 17))
    frames = drawn_votes(truth, confusion, 5)
    errors = measured(frames, codes)
    np.testing.assert_allclose(errors.shares[:3, :3], 0.8 * confusion[:3, :3] + 0.03, atol=0.08)
    layers = mapped(frames, codes, errors)
    new = (truth == LifeForm.TREE) & (codes == CODES[Label.SHRUB])
    assert (layers.life_form[new] == LifeForm.TREE).mean() > 0.85
    assert layers.changed[~new].mean() < 0.01


@pytest.mark.parametrize("known", ["confirms", "contradicts", None])
def test_one_view_changes_no_cell_against_a_known_network_and_counts_less_without_one(known: str | None) -> None:
    truth, codes = landscape(slice(10, 17))
    new = (truth == LifeForm.TREE) & (codes == CODES[Label.SHRUB])
    frames = [frame for frame in drawn_votes(truth, RIGHT, 5) if frame.source == "north"]
    reference = {"confirms": np.where(new, truth, 0).astype(np.uint8), "contradicts": np.zeros_like(truth), None: None}
    errors = measured(frames, codes, reference[known])
    alone = 1 / (1 + errors.correlation.between_views)
    assert errors.one_view == pytest.approx({"confirms": 1, "contradicts": 0, None: alone}[known], abs=1e-3)
    found = mapped(frames, codes, errors).changed[new].mean()
    assert found == 0 if known == "contradicts" else found > 0.8
    # The record keeps it.
    record = record_of(errors, "drawn", site="drawn", live="2026-11-29, 2 views")
    assert record.errors().one_view == errors.one_view
    assert record.state == "measured on site drawn, live (2026-11-29, 2 views)"


def measured(frames: list[CellVotes], codes: np.ndarray, known: np.ndarray | None = None) -> LabelErrors:
    def changes(errors: LabelErrors) -> np.ndarray:
        layers = mapped(frames, codes, errors)
        return np.where(layers.changed, layers.life_form, 0).astype(np.uint8)

    return measure_labels(frames, codes, label_forms(LABELS), 2.0, changes, known, "drawn")


def mapped(frames: list[CellVotes], codes: np.ndarray, errors: LabelErrors) -> Any:
    evidence = EvidenceMap(frames[0].geometry, FuelPrior(codes, frames[0].geometry), LABELS, FusionRules(), errors)
    for frame in frames:
        evidence.add(frame)
    return evidence.layers()
