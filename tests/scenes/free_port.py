"""A TCP port for a server of a test."""

import itertools
import os
import random
import socket
from collections.abc import Iterator

OURS = range(20_000, 32_000)
"""Below those that Linux gives to connections (32768 on): while a server is away, none of them takes its port, and who
tries to reach it does not meet itself."""
WORKERS = 16
"""Of one run of the tests, each of which has ports of its own; of other runs beside it they are drawn apart by
chance."""


def _own() -> Iterator[int]:
    """One after the other, so that none is given twice before its server listens."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % WORKERS
    ports = OURS[worker::WORKERS]
    first = random.SystemRandom().randrange(len(ports))
    return itertools.cycle([*ports[first:], *ports[:first]])


_PORTS = _own()


def free_port() -> int:
    """One on which nobody listens, and that nobody else in this run of the tests is given."""
    while True:
        port = next(_PORTS)
        with socket.socket() as probe:
            try:
                probe.bind(("", port))
            except OSError:
                continue
            return port
