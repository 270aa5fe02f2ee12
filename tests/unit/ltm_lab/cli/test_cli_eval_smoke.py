"""`ltm-lab eval smoke` on painted photos: a plume before a slope, and a pair without."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scenes.networks import write_classifier
from typer.testing import CliRunner

from ltm_core.base.errors import LtmError
from ltm_lab.cli.main import cli


def run(*arguments: object) -> str:
    result = CliRunner().invoke(cli, [str(a) for a in arguments])
    if isinstance(result.exception, LtmError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


def test_smoke_that_is_drawn_is_counted(tmp_path: Path) -> None:
    speckles = np.random.default_rng(3).integers(0, 2, (26, 40)).repeat(8, 0).repeat(8, 1)
    photo = np.zeros((208, 320, 3), np.uint8)
    photo[..., 1] = 120 + 80 * speckles  # lime of two shades: grass
    photo[:60] = (0, 0, 255)  # sky
    Image.fromarray(photo).save(tmp_path / "clear.png")
    photo[100:160, 60:160] = (110, 240, 110)  # pale, and called land
    Image.fromarray(photo).save(tmp_path / "smoke.png")
    area = [[60, 100], [159, 100], [159, 159], [60, 159]]
    pairs = [
        {"earlier": "clear.png", "later": "smoke.png", "smoke": [area]},
        {"earlier": "clear.png", "later": "clear.png", "smoke": []},
    ]
    (tmp_path / "truth.json").write_text(json.dumps(pairs))
    given = [tmp_path, "--model", write_classifier(tmp_path), "--truth", tmp_path / "truth.json"]
    run("eval", "smoke", *given, "--json", tmp_path / "score.json")
    score = json.loads((tmp_path / "score.json").read_text())
    first, second = score["clear.png smoke.png"], score["clear.png clear.png"]
    assert first["hidden"] == 6000
    assert first["in_smoke"] > 3000
    assert first["told"] > 0.8 * first["in_smoke"]
    assert (second["told"], second["wrong"]) == (0, 0)
    (tmp_path / "truth.json").write_text('[{"earlier": 3}]')
    with pytest.raises(LtmError, match="later"):
        run("eval", "smoke", *given)
