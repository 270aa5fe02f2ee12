"""`ltm-lab eval dirty-lens`: what it counts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scenes.tower_pictures import tower_picture
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_lab.cli.main import cli
from ltm_lab.evaluation.segmentation import dirty_pictures
from ltm_lab.evaluation.segmentation.dirty_pictures import CASES


def run(*arguments: object) -> None:
    done = CliRunner().invoke(cli, ["eval", "dirty-lens", *map(str, arguments)])
    if done.exception is not None:
        raise done.exception


def test_photos_and_frames_of_a_camera_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On pictures of half the width; that drops are told in larger ones is in the tests of `DirtyLens`."""
    monkeypatch.setattr(dirty_pictures, "WIDTH", dirty_pictures.WIDTH // 2)
    rng = np.random.default_rng(2)
    Image.fromarray(rng.integers(60, 190, (240, 320, 3)).astype(np.uint8)).save(tmp_path / "rocks.png")
    frames = tmp_path / "frames"
    frames.mkdir()
    for seed, name in enumerate(("west_20180728_a", "west_20190826_1313", "west_20190101_box", "north_20190826")):
        shape = (260, 400) if seed < 2 else (130, 200)
        Image.fromarray(tower_picture(seed)).resize(shape[::-1]).save(frames / f"{name}.png")
    run(tmp_path, "--frames", frames, "--json", tmp_path / "score.json")
    score = json.loads((tmp_path / "score.json").read_text())
    assert score["photos"]["count"] == 1
    told = score["photos"]["told"]
    assert list(told) == list(CASES)
    assert told["clean"] == 0
    assert told["three drops of 14 to 24 %"] == told["a smear"] == 1
    assert score["frames"] == {"count": {"west 400 x 260": 2}, "told": {"west 400 x 260": []}}


def test_nothing_to_look_at_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--frames"):
        run()
    Image.fromarray(tower_picture(1)).save(tmp_path / "west_20180728.png")
    with pytest.raises(RecordingError, match="no two photos"):
        run("--frames", tmp_path)
