"""`ltm-lab eval usable`: what it counts on photos whose state is known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scenes.tower_pictures import tower_picture
from typer.testing import CliRunner

from ltm_core.vision.usable import judge
from ltm_lab.cli.main import cli
from ltm_lab.evaluation.segmentation.spoilt_pictures import WAYS, spoilt


def test_refused_photos_are_named_and_spoilt_ones_counted(tmp_path: Path) -> None:
    for seed in (1, 2):
        Image.fromarray(tower_picture(seed)).save(tmp_path / f"clear_{seed}.png")
    Image.fromarray((tower_picture(3) * 0.08).astype(np.uint8)).save(tmp_path / "dark.png")
    out = CliRunner().invoke(cli, ["eval", "usable", str(tmp_path), "--json", str(tmp_path / "score.json")])
    assert out.exit_code == 0, out.output
    score = json.loads((tmp_path / "score.json").read_text())
    assert (score["photos"], score["refused"]) == (3, {"dark.png": "night"})
    assert score["spoilt"].keys() == WAYS.keys()
    assert score["spoilt"]["blank"] == {"refused": 1.0, "told": 1.0}
    one = CliRunner().invoke(cli, ["eval", "usable", str(tmp_path), "--half", "b", "--json", str(tmp_path / "b.json")])
    assert one.exit_code == 0, one.output
    assert json.loads((tmp_path / "b.json").read_text())["photos"] == 1


@pytest.mark.parametrize("way", ["night, 6 %", "fog, 95 %", "blur, 1 %", "blank"])
def test_a_photo_is_spoilt_as_is_said(way: str) -> None:
    found = spoilt(tower_picture(1, hood=False, caption=""), way, 4)
    np.testing.assert_array_equal(found, spoilt(tower_picture(1, hood=False, caption=""), way, 4))
    assert judge(found).reason is WAYS[way]
