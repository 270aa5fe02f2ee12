"""A TCP port for a server of a test."""

from __future__ import annotations

import random
import socket

OURS = range(20_000, 32_000)
"""Below those that Linux gives to connections (32768 on): while a server is away, none of them takes its port, and who
tries to reach it does not meet itself."""


def free_port() -> int:
    """One on which nobody listens, at random: other tests run beside this one."""
    draws = random.SystemRandom()
    while True:
        port = draws.choice(OURS)
        with socket.socket() as probe:
            try:
                probe.bind(("", port))
            except OSError:
                continue
            return port
