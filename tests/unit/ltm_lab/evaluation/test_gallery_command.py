from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
from PIL import Image
from typer.testing import CliRunner

from ltm_core.vision.labels import Label
from ltm_lab.cli.main import cli

SIZE = (60, 90)


def _towers(data: Path) -> Path:
    """Two photos, blue above brown; a person has named areas in the second, where most of the land is wrong: it is
    called water there, which nothing in the photo looks like."""
    folder = data / "hpwren_towers"
    folder.mkdir(parents=True)
    photo = np.empty((*SIZE, 3), np.uint8)
    photo[:35], photo[35:] = (110, 160, 230), (120, 95, 60)
    for name in ("a_plain", "b_named"):
        Image.fromarray(photo).save(folder / f"{name}.jpg")
    truth = np.full(SIZE, 255, np.uint8)
    truth[:10], truth[50:, 20:70] = Label.SKY, Label.WATER
    Image.fromarray(truth).save(folder / "b_named_labels.png")
    return data


def test_a_page_with_a_sheet_for_each_photo_the_worst_first(tmp_path: Path) -> None:
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    arguments = ["eval", "gallery", "--data", str(_towers(tmp_path / "data")), "--out", str(out)]
    done = CliRunner().invoke(cli, [*arguments, "--part", "towers", "--json", str(figures)])
    assert done.exit_code == 0, done.output
    page = (out / "gallery.html").read_text(encoding="utf-8")
    assert page.index("<h3>b_named") < page.index("<h3>a_plain")
    assert "wrong, of the land named by hand" in page
    files = set(re.findall(r'src="([^"]+)"', page))
    assert len(files) == 2
    sizes = {Image.open(out / file).width for file in files}
    assert len(sizes) == 1  # no photo has more room than another
    named = json.loads(figures.read_text())["Fire-watch towers"]["photos"]["b_named"]
    assert named["fault"] > 0.9
    assert {"name": "water by hand (500 px) is called"}.items() <= next(
        fact.items() for fact in named["facts"] if fact["name"].startswith("water")
    )
