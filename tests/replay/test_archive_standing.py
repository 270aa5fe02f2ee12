"""A run of an archive that finds the map that it would make has nothing to do, and makes it anew where it hangs on what
has changed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from scenes.small_site import BEGIN_NS, FRAMES, SmallSite

from ltm_core.pipeline.stored_fuel import STORE_FILE
from ltm_ros.archive.engine import serial
from ltm_ros.archive.publish import LAYERS, RUN
from ltm_ros.archive.run import ArchiveOptions, Summary, look_through, run

pytestmark = pytest.mark.usefixtures("without_page")


def reprocessed(options: ArchiveOptions) -> Summary:
    return run(look_through(options, lambda done, total: None), serial, lambda done, total: None)


@pytest.fixture
def options(small_site: SmallSite, done: Path, tmp_path: Path) -> ArchiveOptions:
    """Of a copy of these results."""
    shutil.copytree(done, tmp_path / "out")
    return ArchiveOptions((small_site.bag,), small_site.path, str(tmp_path / "out"))


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows by one with each map that is made."""
    from ltm_ros.archive import run as module

    counted, reduce_to_store = list[int](), module.reduce_to_store

    def counting(*args: object) -> object:
        counted.append(len(counted))
        return reduce_to_store(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "reduce_to_store", counting)
    return counted


def test_nothing_is_made_again_where_all_is_there(options: ArchiveOptions, made: list[int]) -> None:
    record = (Path(options.out) / RUN).read_bytes()
    summary = reprocessed(options)
    assert made == []
    assert (summary.worked, summary.merged) == (0, 2 * FRAMES)
    assert (Path(options.out) / RUN).read_bytes() == record


def layer_gone(options: ArchiveOptions) -> ArchiveOptions:
    next((Path(options.out) / LAYERS).iterdir()).unlink()
    return options


def map_gone(options: ArchiveOptions) -> ArchiveOptions:
    (Path(options.out) / STORE_FILE).unlink()
    return options


def record_spoiled(options: ArchiveOptions) -> ArchiveOptions:
    place = Path(options.out) / RUN
    place.write_text(place.read_text()[:-40])
    return options


def one_frame_fewer(options: ArchiveOptions) -> ArchiveOptions:
    return replace(options, since_ns=BEGIN_NS + 1)


@pytest.mark.parametrize("change", [layer_gone, map_gone, record_spoiled, one_frame_fewer])
def test_the_map_is_made_again_after(
    options: ArchiveOptions, made: list[int], change: Callable[[ArchiveOptions], ArchiveOptions]
) -> None:
    reprocessed(change(options))
    assert len(made) == 1
    out = Path(options.out)
    files = json.loads((out / RUN).read_text())["files"]
    assert files
    assert all((out / name).is_file() for name in files)


def test_a_run_that_is_stopped_while_it_writes_claims_nothing(
    options: ArchiveOptions, made: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of another choice of frames, whose layers are there in part, and then the former one again."""
    from ltm_ros.archive.files import ResultFolder

    put = ResultFolder.put

    def killed(folder: ResultFolder, file: Path, name: str) -> None:
        if name == STORE_FILE:
            raise KeyboardInterrupt
        put(folder, file, name)

    with monkeypatch.context() as patched:
        patched.setattr(ResultFolder, "put", killed)
        with pytest.raises(KeyboardInterrupt):
            reprocessed(one_frame_fewer(options))
    assert reprocessed(options).merged == 2 * FRAMES
    assert len(made) == 2
