"""What kind of place a picture shows, told by a label network's own decoder map, so that a head can be chosen for it.

A picture becomes a point: mean and standard deviation of the map's channels over its land, turned so that the pictures
that the network itself was taught on have no mean and unit spread along each axis. A head lies where the photos lie
that taught it, as wide as those of one of its sites are from those of the others.
"""

from __future__ import annotations

import hashlib
from functools import cached_property

import cv2
import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.errors import ModelError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array

LEAST_LAND = 0.05
"""Share of a picture that must be land for it to say where it was taken."""


class DomainSpace(StrictModel):
    """The axes for one network, by its `sha256`: a point is `axes` (D rows of 2C) times the statistics of `map` (C
    channels: means, then deviations) less their `mean`. `measured_on`: which pictures have no mean and unit spread.
    """

    network: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    map: str
    measured_on: str
    mean: tuple[float, ...] = Field(min_length=2)
    axes: tuple[tuple[float, ...], ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _shapes_agree(self) -> DomainSpace:
        if len(self.mean) % 2 or any(len(row) != len(self.mean) for row in self.axes):
            widths = ", ".join(str(n) for n in sorted({len(row) for row in self.axes}))
            raise ValueError(
                f"axes: rows of {widths} numbers, mean of {len(self.mean)}; expected the same, even number"
            )
        return self

    @cached_property
    def checksum(self) -> str:
        """Of the axes: a head's place is only on those that it was measured on."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:12]

    def point(self, values: Float32Array, land: BoolArray) -> Float64Array | None:
        """(D,) of a picture by its map (C, h, w) and where it shows land (H, W); None where there is too little of it.

        Raises ModelError for a map of another number of channels.
        """
        statistics = land_statistics(values, land)
        if statistics is None:
            return None
        if len(statistics) != len(self.mean):
            raise ModelError(
                f"map {self.map!r} of network {self.network!r} has {len(values)} channels; its domains were measured "
                f"with {len(self.mean) // 2}: measure them again (ltm-lab train domains)"
            )
        return np.asarray(np.asarray(self.axes) @ (statistics - np.asarray(self.mean)), np.float64)


class HeadDomain(StrictModel):
    """Where a head's photos lie: `centre` of its sites, and the `spread` along each axis of a site that is not among
    them. `sites`: on how many that was measured; `axes`: checksum of those that it is given on."""

    axes: str
    centre: tuple[float, ...] = Field(min_length=1)
    spread: float = Field(gt=0, le=100)
    sites: int = Field(ge=1)

    def log_odds(self, point: Float64Array) -> float:
        """That a picture (D,) is of the head's kind and not one of those that the network was taught on, by normal
        distributions of both; a mean over the axes, for they are not independent. Raises ModelError for another D."""
        if point.shape != (len(self.centre),):
            raise ModelError(
                f"the head's domain has {len(self.centre)} axes, its network {len(point)}; "
                "teach it again: ltm train head"
            )
        off = (point - np.asarray(self.centre)) / self.spread
        return float(0.5 * (point**2 - off**2).mean() - np.log(self.spread))


def land_statistics(values: Float32Array, land: BoolArray) -> Float64Array | None:
    """(2C,) means and standard deviations of a map's channels (C, h, w) over land (H, W); None where that is less than
    a twentieth of the picture."""
    if land.mean() < LEAST_LAND:
        return None
    rows, cols = values.shape[1:]
    share = cv2.resize(land.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA).reshape(-1)
    share /= share.sum()
    flat = values.reshape(len(values), -1)
    # einsum and not a matrix product, whose threads would spin for cores
    mean = np.einsum("cn,n->c", flat, share)
    square = np.einsum("cn,n->c", (flat - mean[:, None]) ** 2, share)
    return np.concatenate([mean, np.sqrt(square)]).astype(np.float64)
