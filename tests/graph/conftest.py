"""What every test on real ROS processes needs: a domain of its own, and proof that it left nothing behind."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from leftovers import ports_of_domain, processes_of_domain, wait_gone

from ltm_ros.ros_environment import PROFILE_VARIABLES, ros_environment

DOMAINS = range(100, 201)


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain that no other test on this machine has now, set in the environment with the rest that ROS needs.

    Afterwards the test fails when a process of that domain or a shared-memory port of it is left.
    """
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
