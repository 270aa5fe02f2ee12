"""What every test on real ROS processes needs: a domain of its own, and proof that it left nothing behind."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from leftovers import ports_of_domain, processes_of_domain, wait_gone
from scenes.small_site import SmallSite, write_small_site

from ltm_ros.launching.ros_environment import PROFILE_VARIABLES, ros_environment

DOMAINS = range(100, 201)


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
    lock, domain = _claim_domain()
    for name in (*PROFILE_VARIABLES, "RMW_IMPLEMENTATION", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for name, value in ros_environment(domain_id=domain).items():
        monkeypatch.setenv(name, value)
    try:
        yield domain
        assert not (left := wait_gone(lambda: processes_of_domain(domain))), f"processes left behind: {left}"
        assert not (left := wait_gone(lambda: ports_of_domain(domain))), f"shared memory left behind: {left}"
    finally:
        os.close(lock)


@pytest.fixture(scope="module")
def small_site(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    """The small site with its recording, in a folder of its own."""
    return write_small_site(tmp_path_factory.mktemp("small_site"))


def _claim_domain() -> tuple[int, int]:
    """An open lock file and its domain: other test runs on this machine claim theirs in the same way."""
    folder = Path(tempfile.gettempdir()) / "ltm-test-domains"
    folder.mkdir(exist_ok=True)
    start = os.getpid() % len(DOMAINS)
    for number in [*DOMAINS[start:], *DOMAINS[:start]]:
        lock = os.open(folder / str(number), os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            continue
        return lock, number
    raise RuntimeError(f"all ROS domains {DOMAINS} are taken by other test runs")
