"""`tools/same_results.py` finds differences of a byte, a digit, a row, a cell or a message, and nothing else."""

from __future__ import annotations

import sqlite3
import struct
import sys
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
import rasterio
import same_results
from mcap.writer import Writer
from same_results import differences, main


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    found = tmp_path / "before", tmp_path / "after"
    for folder in found:
        folder.mkdir()
    return found


def _found(folders: tuple[Path, Path], name: str, first: bytes, second: bytes) -> list[str]:
    for folder, content in zip(folders, (first, second), strict=True):
        (folder / name).write_bytes(content)
    return list(differences(*folders))


def test_a_byte(folders: tuple[Path, Path]) -> None:
    assert _found(folders, "landscape.lcp", b"\x00\x01\x02", b"\x00\x01\x02") == []
    (found,) = _found(folders, "landscape.lcp", b"\x00\x01\x02", b"\x00\x01\x03")
    assert found.startswith("landscape.lcp: bytes 0 to 15: ")


def test_a_missing_file(folders: tuple[Path, Path]) -> None:
    (folders[1] / "map").mkdir()
    (folders[1] / "map/change.png").touch()
    (folders[0] / "map.ltm.lock").touch()
    assert list(differences(*folders)) == ["map/change.png: only in AFTER"]


def test_a_digit_that_is_printed_but_not_a_word(folders: tuple[Path, Path]) -> None:
    name = f"0{same_results.PRINTED}"
    first = b"azimuth 149.878, sigma 0.19\nreplay 0:00:17, 24105 MB free"
    assert _found(folders, name, first, b"heading 149.878, sigma: 0.19\nreplay 0:01:02, 301 MB free") == []
    (found,) = _found(folders, name, first, first.replace(b"149.878", b"149.879"))
    assert "149.878 -> 149.879" in found
    assert "`azimuth 149.878, sigma 0.19`" in found
    assert _found(folders, name, first, first.replace(b"149.878", b"-149.878"))


def test_processor_time_in_a_report(folders: tuple[Path, Path]) -> None:
    first = b'{"cpu_seconds": 4.98, "gap": 34.9}'
    assert _found(folders, "fit.json", first, first.replace(b"4.98", b"14.916e-5")) == []
    assert _found(folders, "fit.json", first, first.replace(b"34.9", b"34.8"))


def test_a_row(folders: tuple[Path, Path]) -> None:
    def write(tiles: Iterable[tuple[int, bytes]]) -> list[str]:
        for folder, rows in zip(folders, ([(1, b"ab"), (2, b"cd")], tiles), strict=True):
            (folder / "map.ltm").unlink(missing_ok=True)
            with sqlite3.connect(folder / "map.ltm") as store:
                store.execute("CREATE TABLE tiles (row INTEGER, content BLOB)")
                store.executemany("INSERT INTO tiles VALUES (?, ?)", rows)
            store.close()
        return list(differences(*folders))

    assert write([(2, b"cd"), (1, b"ab")]) == []
    assert "table tiles, row 1" in write([(1, b"ab"), (2, b"ce")])[0]
    assert "nothing" in write([(1, b"ab")])[0]


def test_a_cell(folders: tuple[Path, Path]) -> None:
    def write(*values: float, tag: str = "a") -> list[str]:
        for folder, cells, said in zip(folders, ((1.0, np.nan), values), ("a", tag), strict=True):
            grid = np.array([[cells]], np.float32)
            with rasterio.open(folder / "depth.tif", "w", "GTiff", 2, 1, 1, dtype="float32") as raster:
                raster.write(grid)
                raster.update_tags(said=said)
        return list(differences(*folders))

    assert write(1.0, np.nan) == []
    assert write(1.5, np.nan) == ["depth.tif: band 1, row 0, column 0: 1.0 -> 1.5 (1 cells differ)"]
    assert write(1.0, np.nan, tag="b") == ["depth.tif: all cells are the same, tag said: a -> b"]


def test_a_member_of_an_archive(folders: tuple[Path, Path]) -> None:
    for year, (folder, content) in enumerate(zip(folders, ("north", "south"), strict=True), 2025):
        with zipfile.ZipFile(folder / "map.kmz", "w") as archive:
            archive.writestr(zipfile.ZipInfo("same.kml", (year, 1, 1, 0, 0, 0)), "same")
            archive.writestr(zipfile.ZipInfo("doc.kml", (year, 1, 1, 0, 0, 0)), content)
    assert list(differences(*folders)) == ["map.kmz: doc.kml: b'north' -> b'south'"]


def test_tables_whose_names_depend_on_the_program(folders: tuple[Path, Path]) -> None:
    def write(*votes: int) -> list[str]:
        for folder, names, counts in zip(folders, ("ab", "dc"), ((7, 8), votes), strict=True):
            for name, count in zip(names, counts, strict=True):
                pyarrow.parquet.write_table(pyarrow.table({"votes": [count]}), folder / f"{name * 32}.parquet")
            manifest = pyarrow.table({"file": [f"{folder}/bag.mcap"]})
            pyarrow.parquet.write_table(manifest, folder / "manifest.parquet")
        return list(differences(*folders))

    assert write(7, 8) == []
    assert write(7, 9) == ["KEY1.parquet: row 0: {'votes': 8} -> {'votes': 9}"]


def _point(x: float, padding: bytes = bytes(7)) -> bytes:
    """A serialised geometry_msgs/PointStamped, with the bytes between its frame's name and its numbers."""
    return b"\0\1\0\0" + struct.pack("<iII", 5, 0, 5) + b"tent\0" + padding[:7] + struct.pack("<3d", x, 2.0, 3.0)


def _record(path: Path, points: list[tuple[str, int, bytes]]) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("geometry_msgs/msg/PointStamped", "ros2msg", b"")
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic, _, _ in points}
        for topic, stamp, data in points:
            writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([("/b", 7, _point(1)), ("/a", 7, _point(1)), ("/a", 8, _point(4, b"garbage"))], ""),
        (
            [("/a", 7, _point(1)), ("/a", 8, _point(4)), ("/b", 7, _point(9))],
            "/b, message 0 at 7 ns: point.x: 1.0 -> 9",
        ),
        ([("/a", 7, _point(1)), ("/b", 7, _point(1))], "/a, message 1"),
        ([("/a", 7, _point(1)), ("/a", 9, _point(4)), ("/b", 7, _point(1))], "/a, message 1"),
        ([("/a", 7, _point(1)), ("/a", 8, _point(4))], "topic /b: only in BEFORE"),
    ],
)
def test_a_message(folders: tuple[Path, Path], points: list[tuple[str, int, bytes]], expected: str) -> None:
    _record(folders[0] / "bag.mcap", [("/a", 7, _point(1)), ("/a", 8, _point(4)), ("/b", 7, _point(1))])
    _record(folders[1] / "bag.mcap", points)
    found = list(differences(*folders))
    assert [expected in text for text in found] == ([True] if expected else [])


MAKE = """
import sys
from pathlib import Path
Path("job/result.txt").write_text("{result}")
with Path({runs!r}).open("a") as runs:
    runs.write("{result} ")
sys.exit({status})
"""


@pytest.fixture
def compare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Compare two checkouts whose only job writes a file."""
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs/jobs.yaml").write_text(
        "[{name: job, commands: [checkout/make.py]}, {name: other, commands: [checkout/none.py], needs: data/photos}]"
    )
    monkeypatch.setattr(same_results, "FOLDER", tmp_path / "jobs")

    def run(after: str, status: int = 0) -> int:
        for name, result, exit_status in (("one", "42", 0), ("two", after, status)):
            (tmp_path / name / "ltm_ros").mkdir(parents=True, exist_ok=True)
            text = MAKE.format(result=result, runs=str(tmp_path / "runs"), status=exit_status)
            (tmp_path / name / "make.py").write_text(text)
        work = ["--work", str(tmp_path / "work")]
        monkeypatch.setattr(sys, "argv", ["same_results", str(tmp_path / "one"), str(tmp_path / "two"), *work])
        return main()

    return run


def test_results_of_before_are_reused(
    compare: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compare("42") == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("other        skipped: data/photos")
    assert compare("43") == 1
    assert "DIFFERENT: result.txt: line 1" in capsys.readouterr().out
    assert (tmp_path / "runs").read_text().split() == ["42", "42", "43"]


def test_a_command_that_fails_is_a_difference(compare: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> None:
    assert compare("42", status=3) == 1
    assert "in AFTER, `checkout/make.py` failed" in capsys.readouterr().out
