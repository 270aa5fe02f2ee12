"""Some cases of `make fuzz`, the same ones each time; and that the suite finds what it is there to find."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from fuzz import campaign as suite
from fuzz import targets
from fuzz.self_test import SELF_TEST

CASES = 100
OF_FAST = dict.fromkeys(
    (
        *("photo_jpg", "photo_png", "photo_heic", "photo_progressive", "poses_csv", "control_points"),
        "npz",
        *("node_capture", "node_segmentation"),
    ),
    300,
)
OF_SLOW = {
    **dict.fromkeys(("fuel_models", "fusion", "node_topodepth", "node_fuel_map"), 30),
    "video": 40,
    **dict.fromkeys(("network", "node_terrain", "node_viewer"), 10),
}
"""How many cases, by what they cost: a minute of one core together. Not so long, but so many: on each machine the same
are run. `make test` runs the first fifth, in which a reader that has become careless stumbles at once, and the slow
tests run the rest."""
LONGEST_S = 120.0


@pytest.mark.parametrize("part", ["first", pytest.param("rest", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [target.name for target in targets.TARGETS])
def test_no_error_but_ours(name: str, part: str, tmp_path: Path) -> None:
    kept = Path(os.environ.get("LTM_FUZZ_KEPT", tmp_path))
    count = (OF_FAST | OF_SLOW).get(name, CASES)
    first = -(-count // 5)
    tally = suite.cases(name, range(first) if part == "first" else range(first, count), LONGEST_S, kept)
    assert tally.cases
    assert not tally.faults, suite.report({name: tally})


@pytest.mark.parametrize(
    ("order", "found"),
    [
        ("whole", ""),
        ("ours", ""),
        ("imports", ""),
        ("bug", "KeyError: 'not ours'"),
        ("kill", r"ended with -11"),
        ("grow", r"took \d+ MB, at most"),
        ("think", r"took \d\.\d s, at most 0\.1 s"),
        ("hang", r"no end after 1\.5 s"),
    ],
)
def test_what_counts_as_a_fault(order: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each in a process of its own, which is started anew after it; the file is kept."""
    if order == "hang":
        monkeypatch.setattr(suite, "HANGS_AFTER", 1.5)
    if order == "think":
        monkeypatch.setattr(suite, "MOST_SECONDS", 0.1)
    file = tmp_path / "order"
    file.write_bytes(order.encode())
    with suite.Worker(SELF_TEST.name) as worker:
        fault = suite.fault_of(worker.run(file))
        if not found:
            assert fault == ""
        else:
            assert re.search(found, fault)
        monkeypatch.undo()
        file.write_bytes(b"whole")
        assert suite.fault_of(worker.run(file)) == ""  # by a new process, where the old one has died
