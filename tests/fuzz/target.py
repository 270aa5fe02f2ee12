"""What is attacked: a reader of files, or a handler of messages."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fuzz.mutations import Mutate, spoil_bytes

Prepare = Callable[[Path], None]
"""Writes into an empty folder what the reader needs besides the file that is spoiled."""


@dataclass(frozen=True)
class Target:
    """`file`: name of the spoiled file in the folder. `seeds`: whole files, made when asked, small. `read`: takes the
    folder; whatever it raises but LtmError is a fault. `weight`: share of a campaign's time."""

    name: str
    file: str
    seeds: Callable[[Path], list[bytes]]
    read: Callable[[Path], object]
    mutate: Mutate = spoil_bytes
    weight: float = 1.0

    def case(self, number: int, seeds: list[bytes]) -> bytes:
        """The spoiled bytes of a case: the same for the same number and seeds."""
        rng = random.Random(f"{self.name} {number}")
        return self.mutate(rng, rng.choice(seeds), seeds)
