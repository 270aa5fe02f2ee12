"""`ltm-lab eval relative-depth`: networks whose answers are known, scored against true depth."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.depth.monocular import DepthKind, DepthNetwork, NetworkDepth
from ltm_core.geometry.camera import Camera
from ltm_lab.cli import main
from ltm_lab.evaluation.depth.relative_depth import bin_names, score_relative_depth
from ltm_lab.training.training_frames import TrainingFrame

SHAPE = (60, 100)


class Known(DepthNetwork):
    """Answers with values that a test gives it."""

    def __init__(self, values: Float64Array, kind: DepthKind) -> None:
        self.manifest = SimpleNamespace(name="known")  # type: ignore[assignment]
        self._answer = NetworkDepth(values.astype(np.float32), kind)

    def predict(self, rgb: UInt8Array, camera: Camera) -> NetworkDepth:
        return self._answer


def _depth() -> Float64Array:
    """20 m at the foot to 3 km at row 10; sky above."""
    rows = np.arange(SHAPE[0])[:, None] + 0.2 * np.sin(np.arange(SHAPE[1]) / 9.0)[None]
    depth = 20.0 * (3000.0 / 20.0) ** ((SHAPE[0] - 1 - rows) / (SHAPE[0] - 11))
    depth[:10] = np.inf
    return np.asarray(depth)


def _frame(depth: Float64Array, ordinal: bool = False) -> TrainingFrame:
    inverse = np.where(np.isfinite(depth), 1.0 / depth, np.nan).astype(np.float32)
    photo = np.zeros((*SHAPE, 3), np.uint8)
    return TrainingFrame(photo, np.zeros(SHAPE, np.uint8), Path("oak/0001.png"), inverse, ordinal)


@pytest.mark.parametrize(
    ("kind", "answer"),
    [("relative_inverse", lambda d: 7.0 / d + 0.3), ("affine_invariant", lambda d: 0.002 * d + 5.0)],
)
def test_scale_and_shift_are_taken_out(kind: DepthKind, answer: object) -> None:
    depth = _depth()
    values = np.where(np.isfinite(depth), answer(np.where(np.isfinite(depth), depth, 1.0)), 0.0)  # type: ignore[operator]
    score = score_relative_depth(Known(values, kind), [_frame(depth), _frame(depth, ordinal=True)])
    assert (score.frames, score.unfit) == (1, 0)
    assert max(score.abs_rel) < 0.01
    assert score.order == 1.0
    assert score.pixels[-1] == sum(score.pixels[:-1]) == 50 * SHAPE[1]
    assert len(bin_names()) == len(score.abs_rel)


def test_an_error_shows_in_its_own_range_and_in_the_whole() -> None:
    """A quarter too far between 300 m and 1 km: the line of the rest stands, and the error is what was put in."""
    depth = _depth()
    wrong = (depth >= 300) & (depth < 1000)
    values = np.where(np.isfinite(depth), np.where(wrong, 0.8, 1.0) / depth, 0.0)
    score = score_relative_depth(Known(values, "relative_inverse"), [_frame(depth)])
    assert bin_names()[2] == "300-1000 m"
    assert score.abs_rel[2] == pytest.approx(0.25, abs=0.01)
    assert max(score.abs_rel[:2]) < 0.01
    share = score.pixels[2] / score.pixels[-1]
    assert score.abs_rel[-1] == pytest.approx(0.25 * share, abs=0.01)


def test_a_network_that_has_near_and_far_the_wrong_way_round_has_no_fit() -> None:
    depth = _depth()
    values = np.where(np.isfinite(depth), -1.0 / depth, 0.0)
    score = score_relative_depth(Known(values, "relative_inverse"), [_frame(depth)])
    assert (score.unfit, score.order) == (1, 0.0)
    assert np.isnan(score.abs_rel[-1])


def test_metres_are_not_for_this_command() -> None:
    with pytest.raises(ModelError, match=r"known: gives metres.*ltm-lab eval depth"):
        score_relative_depth(Known(np.ones(SHAPE), "metric"), [_frame(_depth())])


def test_the_command_scores_the_shipped_network_on_a_simulated_folder(tmp_path: Path) -> None:
    camera = Camera.from_fov(SHAPE[1], SHAPE[0], 50.0)
    rng = np.random.default_rng(3)
    cv2.imwrite(str(tmp_path / "0001.png"), rng.integers(0, 256, (*SHAPE, 3), dtype=np.uint8))
    cv2.imwrite(str(tmp_path / "0001_labels.png"), np.ones(SHAPE, np.uint8))
    np.savez(tmp_path / "0001_truth.npz", range_surface=_depth().astype(np.float32))
    fields = ("width", "height", "fx", "fy", "cx", "cy", "distortion")
    entry = {"image": "0001.png", "truth_camera": {name: getattr(camera, name) for name in fields}}
    (tmp_path / "frames.json").write_text(json.dumps({"frames": [entry]}))
    arguments = ["eval", "relative-depth", str(tmp_path), "--model", "landscape_lite0_depth"]
    result = CliRunner().invoke(main.cli, [*arguments, "--json", str(tmp_path / "out" / "score.json")])
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "out" / "score.json").read_text())
    score = report["sets"][tmp_path.name]["landscape_lite0_depth"]
    assert (score["frames"], len(score["abs_rel"])) == (1, len(report["ranges"]))
    empty = tmp_path / "empty"
    empty.mkdir()
    refused = CliRunner().invoke(main.cli, ["eval", "relative-depth", str(empty)])
    assert "no frames.json" in str(refused.exception)
