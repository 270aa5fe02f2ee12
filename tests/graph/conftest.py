"""What every test on real ROS processes needs: a domain of its own, and proof that it left nothing behind.

Tests that start graphs may run beside each other, in the workers of one run and in several runs on one machine. What
each looks for afterwards is its own alone: processes that have its domain in their environment, ports that DDS numbers
by it. So that a busy machine makes them slow and not wrong, only so many graphs are up at a time, and all that is
waited for is a condition.
"""

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from leftovers import ports_of_domain, processes_of_domain, wait_gone
from scenes.compiled_kernels import compile_kernels
from scenes.small_site import SmallSite, write_small_site
from scenes.waiting import wait_for

from ltm_ros.runtime.ros_environment import PROFILE_VARIABLES, ros_environment

DOMAINS = range(100, 201)
GRAPHS = (os.cpu_count() or 1) + 2
"""That are up at a time on this machine, of all runs: much of a graph's time is waiting."""
LONGEST_FIRST = (
    "test_site_graph.py",
    "test_runner_processes.py",
    "test_terrain.py",
    "test_health.py",
    "test_fuel_map.py",
    "test_hostile_input.py",
    "test_documented_camera.py",
    "test_layouts.py",
)
"""So that no worker begins with one of these when the others have done their part."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    order = {name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: order.get(item.path.name, len(order)))


@pytest.fixture(scope="session")
def kernels() -> None:
    """Those of the nodes are compiled: else each process of a graph would do it for itself, for minutes."""
    compile_kernels()


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain that no other test on this machine has now, set in the environment with the rest that ROS needs.

    Afterwards the test fails when a process of that domain or a shared-memory port of it is left.
    """
    with _own_domain(monkeypatch) as domain:
        yield domain


@pytest.fixture(scope="module")
def module_ros_domain() -> Iterator[int]:
    """As `ros_domain`, for a graph that all tests of a module share."""
    with pytest.MonkeyPatch.context() as monkeypatch, _own_domain(monkeypatch) as domain:
        yield domain


@contextmanager
def _own_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    if not _slots:
        _slots.append(_claim("slot", range(GRAPHS), patience_s=3600.0)[0])
    lock, domain = _claim("", DOMAINS, first=os.getpid())
    for name in (*PROFILE_VARIABLES, "RMW_IMPLEMENTATION", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for name, value in ros_environment(domain_id=domain).items():
        monkeypatch.setenv(name, value)
    # What a run that was ended by force left in this domain is swept by the first runner that comes, in its own time.
    before = set(ports_of_domain(domain))
    try:
        yield domain
        assert not (left := wait_gone(lambda: processes_of_domain(domain))), f"processes left behind: {left}"
        ports = wait_gone(lambda: [port for port in ports_of_domain(domain) if port not in before])
        assert not ports, f"shared memory left behind: {ports}"
    finally:
        os.close(lock)
        if _slots:
            os.close(_slots.pop())


@pytest.fixture(scope="module")
def small_site(kernels: None, tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    """The small site with its recording, in a folder of its own."""
    return write_small_site(tmp_path_factory.mktemp("small_site"))


@pytest.fixture
def small(tmp_path: Path) -> SmallSite:
    """A small site of the test's own, to be written into; without a recording."""
    (tmp_path / "site").mkdir()
    return write_small_site(tmp_path / "site", recording=False)


_slots: list[int] = []
"""The lock file that gives this process the right to have a graph; one suffices for all that it has."""


def _claim(kind: str, numbers: range, first: int = 0, patience_s: float = 0.0) -> tuple[int, int]:
    """An open lock file and its number: other processes on this machine claim theirs in the same way. It is free again
    when the file is closed, in whatever way the process ends."""
    folder = Path(tempfile.gettempdir()) / "ltm-test-domains"
    folder.mkdir(exist_ok=True)
    start = first % len(numbers)
    claimed: list[tuple[int, int]] = []

    def claim() -> bool:
        for number in [*numbers[start:], *numbers[:start]]:
            lock = os.open(folder / f"{kind}{number}", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o666)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(lock)
                continue
            claimed.append((lock, number))
            return True
        return False

    wait_for(claim, f"one of {numbers} that no other test has", patience_s=patience_s)
    return claimed[0]
