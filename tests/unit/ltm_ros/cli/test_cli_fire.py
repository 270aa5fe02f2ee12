import sys
from pathlib import Path

import numpy as np
import pytest
from scenes.command_line import ltm

from ltm_core.base.errors import LtmError
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.export.landscape_io import write_landscape
from ltm_core.geometry.grid import GridGeometry

GRID = GridGeometry(345_975.0, 3_783_195.0, 30.0, 9, 7, "EPSG:32611")
USUAL = ("--ignition", "346110,3783090", "--wind", "8,45", "--moisture", "D2L2")


@pytest.fixture
def landscapes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """As it is, and as it was."""
    monkeypatch.setenv("LTM_PYRETECHNICS", sys.executable)
    found = []
    for name, code in (("now.tif", 145), ("was.tif", 102)):
        bands = np.zeros((8, *GRID.shape), np.int16)
        bands[3] = code
        bands[3, :, 1] = 98
        found.append(write_landscape(tmp_path / name, Landscape(bands, GRID)))
    return found[0], found[1]


def test_mistakes(landscapes: tuple[Path, Path], tmp_path: Path) -> None:
    now, was = landscapes
    other = GridGeometry(345_975.0, 3_783_195.0, 30.0, 9, 7, "EPSG:32610")
    moved = write_landscape(tmp_path / "moved.tif", Landscape(np.zeros((8, *GRID.shape), np.int16), other))
    out = tmp_path / "out"
    before = ("--before", was, "--out", out)
    for arguments, message in (
        ((now, *USUAL, "--out", out), r"is a single landscape: give the earlier one with --before"),
        ((now, *USUAL, "--before", moved, "--out", out), r"moved.tif is in .*ltm export --crs"),
        ((now, "--ignition", "1,2", *USUAL[2:], *before), r"--ignition 1,2: is outside .*looks like degrees"),
        ((now, "--ignition", "346020,3783090", *USUAL[2:], *before), r"there is water there; the nearest cell"),
        ((now, *USUAL[:4], *before), r"give --moisture"),
        ((now, *USUAL, "--hours", 0, *before), r"--hours 0"),
        ((now, *USUAL, "--since", "2026-01-01", *before), r"--since needs a store"),
        ((tmp_path / "a.ltm", *USUAL, "--out", out), r"give the site file with --site"),
        ((tmp_path / "none.tif", *USUAL, *before), r"none.tif"),
    ):
        with pytest.raises(LtmError, match=message):
            ltm("fire", *arguments)
        assert not out.exists()
