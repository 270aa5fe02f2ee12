"""Fixtures that all tests share."""

import gc
import importlib.util
import os
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path

import pytest
import typer.main
from hypothesis import HealthCheck, settings

REPOSITORY = Path(__file__).parents[1]
LARGE = 300
"""Tests of a run that uses most kernels."""

# How long an example takes is the machine's affair, and that of who else is on it. The same examples each time: what is
# new fails in `make fuzz`, which looks for it.
settings.register_profile(
    "any machine",
    deadline=None,
    derandomize=not os.environ.get("LTM_FUZZ"),
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("any machine")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Half a million objects that live as long as the run: nobody looks for garbage among them, neither now nor in
    tests that collect it to see what is held."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """`make test` looks for graph tests in one folder, as each worker reads all files that it is given."""
    for item in items:
        marks = {mark.name for mark in item.iter_markers()}
        if "graph" in marks and "slow" not in marks and REPOSITORY / "tests/graph" not in item.path.parents:
            raise pytest.UsageError(f"{item.nodeid} is marked graph: it belongs to tests/graph")


def _beside(name: str) -> Path:
    path = REPOSITORY.parent / "shared" / name
    if not path.is_dir():
        pytest.skip(f"needs the real {name} in {path}, which is not part of the repository")
    return path


@pytest.fixture(scope="session", autouse=True)
def _kernels(request: pytest.FixtureRequest) -> None:
    """A large run beside others compiles most kernels first, each once; see `scenes.compiled_kernels`."""
    beside_others = hasattr(request.config, "workerinput")
    if beside_others and len(request.session.items) > LARGE and importlib.util.find_spec("rclpy") is not None:
        from scenes.compiled_kernels import ALL, compile_kernels

        compile_kernels(ALL)


@pytest.fixture(scope="session", autouse=True)
def _one_command_line() -> Iterator[None]:
    """A test's runner builds the description of all commands anew at each call, which takes a fifth of a second, most
    of what a call of a small command takes. They keep nothing of a call: one serves all of this process."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr("typer.testing._get_command", cache(typer.main.get_command))
        yield


@pytest.fixture
def shared_data() -> Path:
    """Real test data, where it is present beside the checkout."""
    return _beside("data")


@pytest.fixture
def shared_models() -> Path:
    """Networks made by others, where they are present beside the checkout."""
    return _beside("models")
