"""Compiled kernels are never older than the source they come from."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from ltm_core.numba_cache import use_own_cache

CALLED = "import numba\n\n@numba.njit(cache=True)\ndef called(x):\n    return x + {term}\n"
CALLER = (
    "import numba\nfrom kernels.called import called\n\n@numba.njit(cache=True)\ndef caller(x):\n    return called(x)\n"
)
INIT = (
    "from pathlib import Path\nfrom ltm_core.numba_cache import use_own_cache\nuse_own_cache(Path(__file__).parent)\n"
)


def answer(folder: Path, first: str = "") -> str:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    paths = [str(folder), *filter(None, sys.path)]
    code = f"{first}\nfrom kernels.caller import caller; print(caller(1.0))"
    run = [sys.executable, "-c", code]
    environment["PYTHONPATH"] = os.pathsep.join(paths)
    return subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize("first", ["", "import numba"])
def test_a_change_in_a_called_kernel_reaches_its_callers(tmp_path: Path, first: str) -> None:
    package = tmp_path / "kernels"
    package.mkdir()
    (package / "__init__.py").write_text(INIT)
    (package / "caller.py").write_text(CALLER)
    (package / "called.py").write_text(CALLED.format(term=1.0))
    assert answer(tmp_path, first) == "2.0"
    (package / "called.py").write_text(CALLED.format(term=10.0))
    assert answer(tmp_path, first) == "11.0"


def test_a_folder_that_the_user_chose_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert use_own_cache(tmp_path) is None
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / "mine")


def test_one_folder_a_state_of_the_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")  # this process goes on with its own
    (tmp_path / "a.py").write_text("1")
    first = use_own_cache(tmp_path)
    assert first is not None
    assert use_own_cache(tmp_path) == first, "the same source, and a variable inherited from us"
    (tmp_path / "a.py").write_text("2")
    second = use_own_cache(tmp_path)
    assert second is not None
    assert second != first
    assert os.environ["NUMBA_CACHE_DIR"] == str(second)


def test_a_folder_that_another_process_deletes_just_now_does_no_harm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    first = use_own_cache(tmp_path)
    assert first is not None
    gone = first.with_name(first.name[:-4] + "gone")
    gone.symlink_to(tmp_path / "nothing")  # listed, but not there when it is looked at
    (tmp_path / "a.py").write_text("2")
    assert use_own_cache(tmp_path) is not None
