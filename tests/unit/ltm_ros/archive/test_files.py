from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import fsspec
import pytest
from scenes.small_site import write_small_site

from ltm_core.base.errors import ArchiveError
from ltm_core.site.site_io import load_site
from ltm_core.storage.image_io import LARGEST_FILE
from ltm_ros.archive import files
from ltm_ros.archive.files import ArchiveFiles, CacheConfig, files_below
from ltm_ros.archive.photo_folder import photo_messages

Store = Callable[[str, bytes], str]


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
    """Puts a file on a store in memory; gives its URL."""
    monkeypatch.setattr(files, "TRIES", 3)
    monkeypatch.setattr(files, "FIRST_WAIT_S", 0.0)
    memory = fsspec.filesystem("memory")

    def put(name: str, content: bytes) -> str:
        memory.pipe_file(f"/files/{name}", content)
        return f"memory:///files/{name}"

    yield put
    memory.store.clear()


@pytest.fixture
def at_hand(tmp_path: Path) -> ArchiveFiles:
    return ArchiveFiles(CacheConfig(str(tmp_path / "cache"), 100))


def cached(tmp_path: Path) -> list[bytes]:
    return sorted(path.read_bytes() for path in (tmp_path / "cache/archive_files").iterdir())


def test_what_is_below_a_place(store: Store, tmp_path: Path) -> None:
    store("b/two.mcap", b"22")
    store("b/a/one.mcap", b"1")
    found = files_below("memory:///files/b")
    assert [(file.name, file.size_bytes) for file in found] == [
        *(("memory:///files/b/a/one.mcap", 1), ("memory:///files/b/two.mcap", 2))
    ]
    (tmp_path / "here.mcap").write_bytes(b"333")
    assert [file.size_bytes for file in files_below(str(tmp_path))] == [3]
    assert files_below(str(tmp_path / "nothing")) == []


def test_what_lies_behind_links_belongs_to_an_archive(tmp_path: Path) -> None:
    """A folder on another disk, once; a link to the folder itself ends; one that leads nowhere is not passed over."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk/a.mcap").write_bytes(b"four")
    (tmp_path / "archive").mkdir()
    for name, to in {"2025": tmp_path / "disk", "again": tmp_path / "disk", "loop": tmp_path / "archive"}.items():
        (tmp_path / "archive" / name).symlink_to(to)
    (tmp_path / "archive/away.mcap").symlink_to(tmp_path / "not_mounted/away.mcap")
    found = files_below(str(tmp_path / "archive"))
    assert [(file.name, file.size_bytes) for file in found] == [
        (str(tmp_path / "archive/2025/a.mcap"), 4),
        (str(tmp_path / "archive/away.mcap"), 0),
    ]


def test_a_file_whose_name_fsspec_takes_apart_is_not_read_as_another(store: Store, at_hand: ArchiveFiles) -> None:
    store("a", b"another one")
    with pytest.raises(ArchiveError, match="with :: are not supported"):
        at_hand.at_hand(store("a::b.mcap", b"its own")).__enter__()


def test_what_is_held_stays_though_another_fetches_it_too(
    store: Store, at_hand: ArchiveFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two begin at once: the second waits for the first, which fetches it, and nobody who makes room takes it from
    either: recordings are opened by their name again and again."""
    kind = fsspec.get_filesystem_class("memory")
    fetch, fetched, go_on = kind.get_file, list[str](), threading.Event()

    def slowly(self: object, path: str, place: str) -> None:
        fetched.append(path)
        go_on.wait(60)
        fetch(self, path, place)

    monkeypatch.setattr(kind, "get_file", slowly)
    url = store("one", b"1" * 60)

    def read(begun: threading.Event) -> bytes:
        begun.set()
        with at_hand.at_hand(url) as path:
            both.wait(60)  # held twice
            if fetched == ["/files/one"]:
                with at_hand.at_hand(other):
                    pass
            both.wait(60)
            return path.read_bytes()

    other = store("two", b"2" * 60)
    both = threading.Barrier(2)
    with ThreadPoolExecutor(2) as pool:
        begun = [threading.Event() for _ in range(2)]
        reading = [pool.submit(read, one) for one in begun]
        for one in begun:
            one.wait(60)
        go_on.set()
        assert [one.result() for one in reading] == [b"1" * 60] * 2
    assert fetched.count("/files/one") == 1


def test_a_file_is_fetched_once_and_anew_when_it_has_changed(
    store: Store, at_hand: ArchiveFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched = list[str]()
    kind = fsspec.get_filesystem_class("memory")
    fetch = kind.get_file
    monkeypatch.setattr(kind, "get_file", lambda self, path, *given: (fetched.append(path), fetch(self, path, *given)))
    url = store("one", b"first")
    for _ in range(2):
        with at_hand.at_hand(url) as path:
            assert path.read_bytes() == b"first"
    assert len(fetched) == 1
    store("one", b"second")
    with at_hand.at_hand(url) as path:
        assert path.read_bytes() == b"second"


def test_the_cache_is_bounded_and_spares_what_is_held(store: Store, at_hand: ArchiveFiles, tmp_path: Path) -> None:
    """Of 100 bytes, three of 40: the third takes the place of the one that nobody holds."""
    urls = [store(name, name.encode() * 40) for name in "abc"]
    (tmp_path / "cache/archive_files").mkdir(parents=True)
    (tmp_path / "cache/archive_files/x.partial").write_bytes(b"of a process that was killed")
    (tmp_path / "cache/others.txt").write_bytes(b"-" * 100)
    with at_hand.at_hand(urls[0]) as held:
        for url in urls[1:]:
            with at_hand.at_hand(url):
                pass
        assert held.read_bytes() == b"a" * 40
        assert cached(tmp_path) == [b"a" * 40, b"c" * 40]
    assert (tmp_path / "cache/others.txt").exists()
    with pytest.raises(ArchiveError, match=r"101 bytes.*100 .*--cache-gb"), at_hand.at_hand(store("d", b"d" * 101)):
        pass


@pytest.mark.parametrize(("failures", "given"), [(2, True), (3, False)])
def test_a_store_is_asked_again_some_times(
    store: Store, at_hand: ArchiveFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failures: int, given: bool
) -> None:
    kind = fsspec.get_filesystem_class("memory")
    fetch, left = kind.get_file, [failures]

    def sometimes(self: object, path: str, place: str) -> None:
        if left[0]:
            left[0] -= 1
            Path(place).write_bytes(b"ha")  # and then the connection ends
            raise OSError("SlowDown")
        fetch(self, path, place)

    monkeypatch.setattr(kind, "get_file", sometimes)
    url = store("one", b"half of it")
    if given:
        with at_hand.at_hand(url) as path:
            assert path.read_bytes() == b"half of it"
    else:
        with pytest.raises(ArchiveError, match=r"one cannot be read now \(OSError: SlowDown, tried 3 times"):
            at_hand.at_hand(url).__enter__()
        assert cached(tmp_path) == []


def test_a_photo_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = load_site(write_small_site(tmp_path, recording=False).path)
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "poses.csv").write_text("name,camera,stamp\nhuge.jpg,tower,2026-06-01T12:00:00Z\n")
    with (folder / "huge.jpg").open("wb") as file:
        file.truncate(LARGEST_FILE + 1)  # it takes no room
    photo, listed = files_below(str(folder))
    monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail(f"{path} is read"))
    (message,) = photo_messages(listed, [photo], site, ArchiveFiles(CacheConfig()))
    assert f"huge.jpg has {LARGEST_FILE + 1} bytes; the maximum is 256 MiB" in message.trouble
