"""What the gallery shows: real photos with what was made of them, and what was measured of each."""

from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float32Array, RgbImage, UInt8Array
from ltm_core.depth.topodepth import FusedDepth


@dataclass(frozen=True)
class Fact:
    """One thing that was measured. `unit`: "%" of a share from 0 to 1, a unit that is written behind, or nothing."""

    name: str
    value: float | int | str
    unit: str = ""

    def shown(self) -> str:
        """The value as people write it."""
        if isinstance(self.value, str):
            return self.value
        if isinstance(self.value, float) and not np.isfinite(self.value):
            return "none"
        if self.unit == "%":
            return f"{self.value:.1%}"
        number = f"{self.value:,}" if isinstance(self.value, int) else f"{self.value:.3g}"
        return f"{number} {self.unit}".rstrip()


@dataclass(frozen=True, eq=False)
class Exhibit:
    """One photo (H, W, 3); all else is of its size, or None where there is none.

    `labels`: class ids. `truth`: what a person, or a survey, says of them, 255 where nothing. `traced`: metres along
    the optical axis; +inf sky, NaN unknown. `fault`: the share by which a section is ordered, worst first; NaN: none.
    """

    name: str
    photo: RgbImage
    labels: UInt8Array
    facts: tuple[Fact, ...]
    fault: float
    truth: UInt8Array | None = None
    traced: Float32Array | None = None
    fused: FusedDepth | None = None


@dataclass(frozen=True, eq=False)
class Section:
    """Photos of one kind. `rule`: which photos are taken, as it was fixed before any was looked at. `fault`: what the
    exhibits' faults are shares of. `note`: what a reader must know of the data. `facts`, `sheets`: of all together."""

    title: str
    rule: str
    fault: str
    note: str
    exhibits: tuple[Exhibit, ...]
    facts: tuple[Fact, ...] = ()
    sheets: tuple[tuple[str, RgbImage], ...] = ()

    def worst_first(self) -> tuple[Exhibit, ...]:
        """The exhibits by their faults; those whose fault is not known come last, in the order given."""
        return tuple(sorted(self.exhibits, key=lambda shown: -shown.fault if np.isfinite(shown.fault) else np.inf))
