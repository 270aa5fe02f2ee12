import struct
from pathlib import Path

import pytest
import same_results
from mcap.writer import Writer
from same_results import differences


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
