"""Faults are drawn by the seed alone, and strangers send what they say."""

from __future__ import annotations

import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from chaos.cameras import CAMERAS
from chaos.faults import FAULTS, Arena, Fault, draw_fault
from chaos.stranger import ATTACKS, FLOODS, Stranger
from rclpy.serialization import serialize_message

NODES = ("fuel_map", "terrain", "recorder", "tower/depth", "mast/capture")


def drawn(seed: int, count: int = 300) -> list[Fault]:
    site: Any = SimpleNamespace(nodes=NODES)
    cameras: Any = SimpleNamespace()
    arena, rng = Arena(site, cameras, {"state": Path("a"), "recording": Path("b")}), random.Random(seed)
    return [draw_fault(list(FAULTS), arena, rng) for _ in range(count)]


def test_a_seed_draws_the_same_faults() -> None:
    first = [fault.name for fault in drawn(7)]
    assert first == [fault.name for fault in drawn(7)]
    assert first != [fault.name for fault in drawn(8)]
    assert len(set(first)) > 100


def test_whom_a_fault_touches() -> None:
    by_name = {fault.name: fault for fault in drawn(3, 2000)}
    assert by_name["kill tower/depth"].touches == ("tower",)
    assert by_name["kill tower/depth"].restarts == ("tower/depth",)
    assert by_name["hang fuel_map"].touches == CAMERAS
    assert by_name["hang terrain"].touches == CAMERAS, "their frames wait for it to finish others"
    assert by_name["terminate recorder"].touches == ()
    assert by_name["kill runner"].whole_start
    for name, fault in by_name.items():
        if name.startswith("full disk of state"):
            assert fault.touches == CAMERAS
        if name.startswith(("full disk of recording", "covariances")):
            assert fault.touches == ()


@pytest.mark.parametrize("attack", sorted(ATTACKS))
def test_an_attack_ends_and_its_messages_can_be_sent(attack: str) -> None:
    """All that is sent has another stamp than any frame could bear by then, or none."""
    stranger = Stranger("tower", random.Random(1))
    sent = 0
    for topic, message in ATTACKS[attack](stranger):
        assert isinstance(message, bytes) or len(serialize_message(message)) > 8
        assert isinstance(message, bytes | topic.type)
        sent += 1
    assert sent >= 6


def test_floods_go_on() -> None:
    for flood in FLOODS.values():
        messages = flood(Stranger("mast", random.Random(1)))
        assert len({next(messages)[0] for _ in range(50)}) == 1
