"""The votes of a traced image in one call."""

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.fuel.votes import CellVotes, VoteCaster
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem


def cast_votes(
    ranges: RangeImage,
    labels: UInt8Array,
    geometry: GridGeometry,
    dem: Dem,
    votes_for: BoolArray,
    stamp_ns: int,
    source: str,
    max_range: float = np.inf,
    confidence: UInt8Array | None = None,
    covariance: ArrayLike | None = None,
) -> CellVotes:
    """The votes of a traced image; see `VoteCaster.cast`."""
    if labels.shape != ranges.range.shape:
        raise ImageError(f"labels of {labels.shape} and ranges of {ranges.range.shape} are not of one image")
    caster = VoteCaster(geometry, dem, votes_for, max_range, ranges.bend)
    return caster.cast(
        ranges.range, ranges.camera, ranges.pose, labels, stamp_ns, source, confidence, covariance, along_axis=False
    )
