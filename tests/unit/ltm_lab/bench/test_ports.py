"""Ports for the servers of trials: each is given once."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest

from ltm_lab.bench import ports
from ltm_lab.bench.ports import LOOPBACK, PORTS, free_ports

CHILD = """
from ltm_lab.bench.ports import free_ports
print(*free_ports(20), flush=True)
input()
"""


def test_no_port_is_given_twice_by_two_processes() -> None:
    with subprocess.Popen([sys.executable, "-c", CHILD], text=True, stdin=-1, stdout=-1) as other:
        assert other.stdout is not None
        theirs = {int(word) for word in other.stdout.readline().split()}
        ours = free_ports(20) + free_ports(20)
        assert len(theirs) == 20
        assert len({*ours, *theirs}) == 60
        assert {*ours, *theirs} <= set(PORTS)
        other.communicate("\n")
    for port in ours[:3]:  # nobody listens there
        with socket.socket() as server:
            server.bind((LOOPBACK, port))
            server.listen()


def test_more_than_there_are_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "PORTS", range(31_000, 31_003))
    with pytest.raises(OSError, match="fewer than 4 of the ports 31000 to 31002"):
        free_ports(4)
    assert len(free_ports(1)) == 1  # those of a refusal are free again
