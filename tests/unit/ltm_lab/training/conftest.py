"""Frames that several tests train on."""

from pathlib import Path

import pytest
from scenes.tiny_training import write_drawn


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    for index, scenario in enumerate(["ash", "elm", "fir", "oak"]):
        for number in range(3):
            write_drawn(tmp_path / "frames" / scenario, 10 * index + number)
    return tmp_path / "frames"
