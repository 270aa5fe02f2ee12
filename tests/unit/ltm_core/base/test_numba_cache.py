import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from ltm_core.base.numba_cache import CPU_LEVELS, _copy, levels_of, precompiled_name, use_own_cache

CALLED = "import numba\n\n@numba.njit(cache=True)\ndef called(x):\n    return x + {term}\n"
CALLER = (
    "import numba\nfrom kernels.called import called\nfrom kernels import (  # over lines\n    constants,\n)\n\n"
    "@numba.njit(cache=True)\ndef caller(x):\n    return called(x) + constants.OFFSET\n"
)
CONSTANTS = "from kernels.origin import OFFSET\n"
ORIGIN = "OFFSET = {offset}\n"
INIT = """from pathlib import Path
from ltm_core.base.numba_cache import use_own_cache
use_own_cache(Path(__file__).parent)
"""


@pytest.fixture(autouse=True)
def _own_folder_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """This process goes on with its own folder afterwards."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "kernels"
    folder.mkdir()
    (folder / "__init__.py").write_text(INIT)
    (folder / "caller.py").write_text(CALLER)
    (folder / "called.py").write_text(CALLED.format(term=1.0))
    (folder / "constants.py").write_text(CONSTANTS)
    (folder / "origin.py").write_text(ORIGIN.format(offset=0.0))
    return folder


def hits(folder: Path, first: str = "", **variables: str) -> str:
    """What a process prints that does `first` and calls the kernel: its result, how many kernels were loaded from the
    cache, and the level they were compiled for."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")} | variables
    environment["PYTHONPATH"] = os.pathsep.join([str(folder), *filter(None, sys.path)])
    code = (
        f"{first}\nimport kernels, numba; from kernels.caller import caller\n"
        "print(caller(1.0), sum(caller.stats.cache_hits.values()), numba.config.CPU_NAME or '')"
    )
    run = [sys.executable, "-c", code]
    return subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout[:-1]


def answer(folder: Path, first: str = "") -> str:
    return hits(folder, first).split()[0]


@pytest.mark.parametrize("first", ["", "import numba"])
def test_a_change_in_a_called_kernel_reaches_its_callers(tmp_path: Path, package: Path, first: str) -> None:
    assert answer(tmp_path, first) == "2.0"
    (package / "called.py").write_text(CALLED.format(term=10.0))
    assert answer(tmp_path, first) == "11.0"


def test_a_constant_that_a_kernel_has_through_other_modules_reaches_it(tmp_path: Path, package: Path) -> None:
    assert answer(tmp_path) == "2.0"
    (package / "origin.py").write_text(ORIGIN.format(offset=0.25))
    assert answer(tmp_path) == "2.25"


def test_a_folder_that_the_user_chose_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert use_own_cache(tmp_path) is None
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / "mine")


@pytest.fixture
def shared_tmp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A source that only a common folder is left for, as files lie where the other places would be; and that folder."""
    source, home, common = tmp_path / "source", tmp_path / "home", tmp_path / "tmp"
    for folder in (source, home, common):
        folder.mkdir()
    (source / "a.py").write_text("import numba")
    for taken in (source / "__pycache__", home / ".cache"):
        taken.write_text("no folder")
    monkeypatch.setattr(Path, "home", lambda: home)
    monkeypatch.setattr("tempfile.tempdir", str(common))
    return source, common / f"ltm-{os.getuid()}"


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o755])
def test_a_place_that_others_get_at_is_not_taken(shared_tmp: tuple[Path, Path], mode: int) -> None:
    source, place = shared_tmp
    place.mkdir()
    place.chmod(mode)
    assert use_own_cache(source) is None
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_a_place_of_another_owner_is_not_taken(shared_tmp: tuple[Path, Path]) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root gives folders away")
    source, place = shared_tmp
    place.mkdir(mode=0o700)
    os.chown(place, 65_534, 65_534)
    assert use_own_cache(source) is None
    os.chown(place, 0, 0)
    found = use_own_cache(source)
    os.chown(found, 65_534, 65_534)
    assert use_own_cache(source) is None, "a folder of kernels that somebody left in ours"


V2 = CPU_LEVELS["x86-64-v2"]
V3 = CPU_LEVELS["x86-64-v3"]


@pytest.mark.parametrize(
    ("flags", "levels"),
    [
        (V3 | {"avx512f", "amx_tile"}, ["x86-64-v3", "x86-64-v2"]),
        *((V3 - {missing}, ["x86-64-v2"]) for missing in sorted(V3 - V2)),
        (V2, ["x86-64-v2"]),
        *((V3 - {missing}, []) for missing in sorted(V2)),
    ],
)
def test_no_kernel_is_loaded_that_the_processor_cannot_run(flags: frozenset[str], levels: list[str]) -> None:
    assert levels_of(flags) == levels


@pytest.fixture
def release(tmp_path: Path) -> Path:
    """A package with kernels that were compiled for the oldest level elsewhere."""
    built = tmp_path / "built/kernels"
    built.mkdir(parents=True)
    (built / "__init__.py").write_text(
        "from pathlib import Path\nfrom ltm_core.base.kernels import use_cache\nuse_cache(Path(__file__).parent)\n"
    )
    for name, text in (("caller", CALLER), ("called", CALLED.format(term=1.0)), ("constants", CONSTANTS)):
        ours = text.replace("import numba\n", "from ltm_core.base.kernels import kernel\n")
        (built / f"{name}.py").write_text(ours.replace("numba.njit(cache=True)", "kernel()"))
    (built / "origin.py").write_text(ORIGIN.format(offset=0.0))
    assert hits(built.parent, NUMBA_CPU_NAME="x86-64-v2", NUMBA_CPU_FEATURES="") == "2.0 0 x86-64-v2"
    (folder,) = (built / "__pycache__").glob("ltm-kernels-*")
    state = folder.name.rpartition("-")[2]
    (built / "precompiled").mkdir()
    folder.rename(built / "precompiled" / precompiled_name(state, "x86-64-v2"))
    return built.parent.rename(tmp_path / "installed")


def test_a_release_runs_its_kernels_where_it_is_installed(release: Path) -> None:
    assert hits(release) == "2.0 1 x86-64-v2"
    assert hits(release) == "2.0 1 x86-64-v2"


def test_kernels_of_a_release_whose_source_was_changed_are_not_loaded(release: Path) -> None:
    (release / "kernels/origin.py").write_text(ORIGIN.format(offset=0.25))
    assert hits(release) == "2.25 0 "


def test_a_copy_of_a_releases_kernels_is_ours_alone(tmp_path: Path) -> None:
    (tmp_path / "release/module").mkdir(parents=True, mode=0o755)
    (tmp_path / "release/module/kernel.nbc").write_bytes(b"code")
    _copy(tmp_path / "release", tmp_path / "ours")
    assert (tmp_path / "ours").stat().st_mode & 0o777 == 0o700
    assert (tmp_path / "ours/module/kernel.nbc").read_bytes() == b"code"


def test_a_folder_that_another_process_deletes_just_now_does_no_harm(tmp_path: Path) -> None:
    first = use_own_cache(tmp_path)
    gone = first.with_name(first.name[:-4] + "gone")
    gone.symlink_to(tmp_path / "nothing")  # listed, but not there when it is looked at
    (tmp_path / "a.py").write_text("import numba  # edited")
    assert use_own_cache(tmp_path) is not None


def test_a_place_in_a_common_folder_is_made_for_us_alone(shared_tmp: tuple[Path, Path]) -> None:
    source, place = shared_tmp
    found = use_own_cache(source)
    assert found.parent == place
    assert [folder.stat().st_mode & 0o777 for folder in (place, found)] == [0o700, 0o700]
    assert use_own_cache(source) == found


def test_a_link_is_not_taken_for_a_place(shared_tmp: tuple[Path, Path]) -> None:
    source, place = shared_tmp
    elsewhere = place.with_name("elsewhere")
    elsewhere.mkdir(mode=0o700)
    place.symlink_to(elsewhere)
    assert use_own_cache(source) is None
