import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.uplink.outbox_io import Outbox, OutboxFrame

SECOND = 10**9


def frame(number: int, camera: str = "east", view: int = 0, size: int = 100) -> OutboxFrame:
    return OutboxFrame(camera, number * SECOND, view, "landscape_lite0", bytes([number % 251]) * size)


def opened(folder: Path, max_bytes: int = 10_000, max_age_s: float = 1e6) -> closing[Outbox]:
    return closing(Outbox(folder / "outbox.sqlite", max_bytes, max_age_s))


def keys_of(outbox: Outbox) -> set[tuple[str, int]]:
    return {key for key, _ in outbox.waiting(10_000, 1e12)}


def frames(outbox: Outbox, limit: int, now_s: float, **named: Any) -> list[OutboxFrame | None]:
    """What waits, and that its size is stated."""
    waiting = outbox.waiting(limit, now_s, **named)
    found = [outbox.frame(key) for key, _ in waiting]
    assert [len(one.message) for one in found if one] == [size for _, size in waiting]
    return found


def test_what_was_put_is_there_after_opening_again_and_the_newest_comes_first(tmp_path: Path) -> None:
    with opened(tmp_path) as outbox:
        assert (outbox.frames, outbox.bytes, outbox.oldest_ns()) == (0, 0, None)
        assert outbox.put([frame(5), frame(7, "west"), frame(6)]) == 3
    with opened(tmp_path) as outbox:
        assert (outbox.frames, outbox.bytes, outbox.oldest_ns()) == (3, 300, 5 * SECOND)
        assert frames(outbox, 2, 0.0) == [frame(7, "west"), frame(6)]
        assert frames(outbox, 2, 0.0, without=[("west", 7 * SECOND)]) == [frame(6), frame(5)]


def test_a_frame_is_kept_once_and_goes_when_it_is_acknowledged(tmp_path: Path) -> None:
    with opened(tmp_path) as outbox:
        assert outbox.put([frame(5), frame(6)]) == 2
        assert outbox.put([frame(6, size=300), frame(7)]) == 1
        assert outbox.bytes == 300
        assert outbox.acknowledge([("east", 6 * SECOND), ("east", 6 * SECOND), ("north", 5 * SECOND)]) == 1
        assert keys_of(outbox) == {("east", 5 * SECOND), ("east", 7 * SECOND)}
        assert (outbox.frames, outbox.bytes) == (2, 200)


def test_a_frame_that_was_refused_is_offered_later_and_by_the_next_process_at_once(tmp_path: Path) -> None:
    with opened(tmp_path) as outbox:
        outbox.put([frame(5), frame(6)])
        outbox.postpone([("east", 6 * SECOND)], until_s=700.0)
        assert frames(outbox, 9, 699.0) == [frame(5)]
        assert frames(outbox, 9, 700.0) == [frame(6), frame(5)]
    with opened(tmp_path) as outbox:
        assert frames(outbox, 9, 0.0) == [frame(6), frame(5)]


def test_of_an_outbox_that_is_full_the_oldest_are_thinned_and_each_view_is_kept(tmp_path: Path) -> None:
    with opened(tmp_path, max_bytes=2_000) as outbox:
        outbox.put([frame(number, view=number % 2 if number < 4 else 2) for number in range(24)])
        removed = outbox.bound(None)
        # Of the older twelve: 2 and 3, the second of their views, and each other of 4 to 11.
        assert removed == (0, 6)
        assert {key[1] // SECOND for key in keys_of(outbox)} == {0, 1, 4, 6, 8, 10, *range(12, 24)}
        assert outbox.bound(None) == (0, 0)


@pytest.mark.parametrize(("room", "kept"), [(900, {0, 8, 9}), (200, {9}), (60, set())])
def test_no_view_is_lost_while_another_has_two_frames(tmp_path: Path, room: int, kept: set[int]) -> None:
    with opened(tmp_path, max_bytes=room) as outbox:
        outbox.put([frame(number, view=max(number - 7, 0)) for number in range(10)])
        outbox.bound(None)
        assert outbox.bytes <= 0.9 * room
        assert kept <= {key[1] // SECOND for key in keys_of(outbox)}


def test_what_is_too_old_goes_only_where_the_time_is_known(tmp_path: Path) -> None:
    with opened(tmp_path, max_age_s=60.0) as outbox:
        outbox.put([frame(5), frame(70)])
        assert outbox.bound(None) == (0, 0)
        assert outbox.bound(66 * SECOND) == (1, 0)
        assert keys_of(outbox) == {("east", 70 * SECOND)}


def test_a_second_process_is_refused_and_another_programs_file_stays(tmp_path: Path) -> None:
    with opened(tmp_path), pytest.raises(StoreError, match="another process"):
        opened(tmp_path)
    with closing(sqlite3.connect(tmp_path / "other.sqlite")) as other:
        other.execute("PRAGMA application_id = 77")
        other.execute("CREATE TABLE mine (x)")
    before = (tmp_path / "other.sqlite").read_bytes()
    with pytest.raises(ConfigError, match="not an LTM outbox"):
        Outbox(tmp_path / "other.sqlite", 1, 1.0)
    assert (tmp_path / "other.sqlite").read_bytes() == before
    with pytest.raises(ConfigError, match="create it first"):
        Outbox(tmp_path / "missing/outbox.sqlite", 1, 1.0)


def test_a_damaged_file_is_put_aside_and_a_new_one_begins(tmp_path: Path) -> None:
    with opened(tmp_path) as outbox:
        outbox.put([frame(number, size=5_000) for number in range(40)])
    path = tmp_path / "outbox.sqlite"
    content = bytearray(path.read_bytes())
    content[4096 : len(content) // 2] = bytes(len(content) // 2 - 4096)
    path.write_bytes(content)
    with opened(tmp_path) as outbox:
        assert "outbox.sqlite.damaged" in outbox.damage
        assert outbox.frames == 0
        assert outbox.put([frame(1)]) == 1
    assert (tmp_path / "outbox.sqlite.damaged").read_bytes() == content
    with opened(tmp_path) as outbox:
        assert (outbox.damage, outbox.frames) == ("", 1)


WRITER = """
import sys
from contextlib import closing
from pathlib import Path
from ltm_core.uplink.outbox_io import Outbox, OutboxFrame

with closing(Outbox(Path(sys.argv[1]), 10**9, 1e9)) as outbox:
    for number in range(int(sys.argv[2]), 10**6):
        outbox.put([OutboxFrame("east", 2 * number + k, 0, "", bytes([number % 251]) * 9000) for k in range(2)])
        print(number, flush=True)
        if number % 3 == 0:
            outbox.acknowledge([("east", 2 * number)])
            print(f"gone {2 * number}", flush=True)
"""


def test_a_kill_at_any_moment_leaves_whole_transactions(tmp_path: Path) -> None:
    """Of 4 processes, each killed in the middle of its writes: all that was told holds, and pairs are whole."""
    path, begin = tmp_path / "outbox.sqlite", 0
    gone: set[int] = set()
    for turn in range(4):
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path), str(begin)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(5 + 6 * turn)]
        process.send_signal(signal.SIGKILL)
        lines += process.communicate()[0].splitlines(keepends=True)
        whole = [line.strip() for line in lines if line.endswith("\n")]
        told = {int(line) for line in whole if line.isdecimal()}
        gone |= {int(line.removeprefix("gone ")) for line in whole if line.startswith("gone ")}
        with closing(Outbox(path, 10**9, 1e9)) as outbox:
            assert not outbox.damage
            found = {stamp for _, stamp in keys_of(outbox)}
        numbers = {stamp // 2 for stamp in found}
        assert len(told) > 3
        assert numbers == set(range(max(numbers) + 1)) >= told
        assert not gone & found
        # What is missing without a word was let go just before the kill.
        missing = {2 * number + k for number in numbers for k in range(2)} - found
        assert len(missing - gone) <= turn + 1
        assert all(stamp % 6 == 0 for stamp in missing)
        begin = max(numbers) + 1
