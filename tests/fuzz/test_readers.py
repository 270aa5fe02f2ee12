"""Every reader of foreign bytes takes spoiled ones, or refuses them with an error of ours.

`LTM_FUZZ_FIRST=812 pytest tests/fuzz/test_readers.py -k store` begins with case 812 of the target `store`.
"""

import itertools
import os
import random
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fuzz import target as bounds
from fuzz.array_files import ARRAY_FILES
from fuzz.bag_files import BAG_FILES
from fuzz.camera_answers import CAMERA_ANSWERS
from fuzz.capture_files import CAPTURE_FILES
from fuzz.head_answers import HEAD_ANSWERS
from fuzz.messages import MESSAGES
from fuzz.photo_files import PHOTO_FILES
from fuzz.raster_files import RASTER_FILES
from fuzz.region_link import REGION_LINK
from fuzz.store_files import STORE_FILES
from fuzz.target import Target
from fuzz.text_files import TEXT_FILES
from ltm_core.base.errors import ConfigError

TARGETS = (
    *(*TEXT_FILES, *PHOTO_FILES, *CAPTURE_FILES, *RASTER_FILES, *STORE_FILES, *BAG_FILES, *ARRAY_FILES),
    *(*CAMERA_ANSWERS, *HEAD_ANSWERS, *MESSAGES, *REGION_LINK),
)
MINUTES = float(os.environ.get("LTM_FUZZ", 0))
"""In `make fuzz`, for all targets together: new cases. Else the same ones each time."""
CASES = 20
CASES_OF = {
    **dict.fromkeys(("photo_jpg", "photo_png", "photo_heic", "photo_progressive", "poses_csv", "control_points"), 60),
    **dict.fromkeys(("npz", "bag", "node_capture", "node_segmentation"), 60),
    **dict.fromkeys(("fuel_models", "fusion", "node_topodepth", "node_fuel_map"), 6),
    **dict.fromkeys(("network", "node_terrain", "node_viewer"), 2),
    "site": 8,
}
"""How many `make test` runs, by what they cost; the slow tests run four times as many after these."""

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.mark.parametrize("part", ["first", pytest.param("rest", marks=pytest.mark.slow)])
@pytest.mark.parametrize("target", TARGETS, ids=[target.name for target in TARGETS])
def test_no_error_but_ours(target: Target, part: str, tmp_path: Path) -> None:
    seeds = target.seeds(tmp_path)
    for whole in seeds:  # is taken, and what is compiled or imported once is not counted
        target.write(tmp_path, whole)
        target.read(tmp_path)
    count = CASES_OF.get(target.name, CASES)
    numbers = iter(range(count) if part == "first" else range(count, 5 * count))
    if MINUTES:
        numbers = itertools.count(random.SystemRandom().randrange(1, 1 << 31))
    if first := os.environ.get("LTM_FUZZ_FIRST"):
        numbers = itertools.chain([int(first)], numbers)
    until = time.monotonic() + 60.0 * MINUTES / len(TARGETS) / 2
    for number in numbers:
        try:
            target.attack(tmp_path, target.case(number, seeds))
        except BaseException as error:
            error.add_note(f"LTM_FUZZ_FIRST={number}; the file is in {tmp_path}")
            raise
        if MINUTES and time.monotonic() > until:
            break


def _think(folder: Path) -> None:
    until = time.process_time() + 0.1
    while time.process_time() < until:
        pass


def _refuse(folder: Path) -> None:
    raise ConfigError("")


@pytest.mark.parametrize(
    ("read", "fault"),
    [
        (_think, AssertionError),
        (_refuse, AssertionError),
        (lambda folder: np.ones(600 << 20, np.uint8), AssertionError),
        (lambda folder: np.ones(3 << 30, np.uint8), MemoryError),
        (lambda folder: {}["not ours"], KeyError),
    ],
    ids=["thinks", "without a message", "grows", "beyond the spare", "not ours"],
)
def test_what_counts_as_a_fault(
    read: Callable[[Path], object], fault: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if read is _think:
        monkeypatch.setattr(bounds, "MOST_SECONDS", 0.05)
    with pytest.raises(fault):
        Target("self", "file", lambda folder: [b""], read).attack(tmp_path, b"")
