"""Memory of the live view in the graph's load test: viewer and server in sum, and which process is the server."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from ltm_lab.bench.graph_view import SERVER, VIEWER, ViewResult, with_server
from ltm_lab.bench.growth import Sample
from ltm_lab.bench.process_usage import Usage


def held(kb: int) -> Usage:
    return Usage(kb, kb, kb, 1, 1, 0.0)


def test_viewer_and_server_count_together() -> None:
    kb = 1_000_000 // 1024 + 1
    samples = [
        Sample(0.0, {"cameras": held(9 * kb)}, 0, 0),
        Sample(2.0, {VIEWER: held(3 * kb), SERVER: held(5 * kb)}, 0, 0),
        Sample(4.0, {VIEWER: held(4 * kb), SERVER: held(2 * kb), "cameras": held(kb)}, 0, 0),
    ]
    found = ViewResult.of(samples, 7_000_000)
    assert (found.most_mb, found.last_mb, found.server_most_mb) == pytest.approx((8.0, 6.0, 5.0), rel=0.01)
    assert [seconds for seconds, _ in found.course] == [2.0, 4.0]
    assert found.taken_mb == 7.0


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_server_is_the_viewers_child() -> None:
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        children = with_server({VIEWER: child.pid})
        assert children == {VIEWER: child.pid}, "it has none"
        assert SERVER in with_server({VIEWER: os.getpid()})
        assert with_server({"cameras": os.getpid()}) == {"cameras": os.getpid()}
    finally:
        child.communicate(b"\n")
