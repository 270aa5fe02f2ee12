"""Configure the living terrain of a site, and the errors of poses."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array


class PoseErrorConfig(StrictModel):
    """Standard deviations of a pose that comes without a covariance."""

    angle_deg: float = Field(0.3, gt=0)
    """Of each angle. What surveyed mounts keep; a phone's compass is off by five degrees, and should say so."""
    position: float = Field(0.5, gt=0)
    """Metres, of each coordinate."""

    def covariance(self) -> Float64Array:
        """(6, 6): position, then rotation about the map's axes, in metres and radians."""
        return np.diag([self.position**2] * 3 + [math.radians(self.angle_deg) ** 2] * 3)


class TerrainConfig(StrictModel):
    """The living terrain; a site that has this section runs the node `terrain`. Lengths in metres, times in seconds."""

    resolution: float | None = Field(None, gt=0)
    """Cell size; None: the DEM's."""
    min_range: float = Field(20.0, ge=0)
    """Anything nearer is taken for an object close to the lens and ignored."""
    max_range: float = Field(1500.0, gt=0)
    """Beyond it, depth is too coarse to move a cell."""
    columns: int = Field(960, ge=1)
    """Of an image, at most so many are used, evenly spaced, and rows as far apart."""
    threshold: float = Field(1.5, gt=0)
    """Change of height that is worth reporting."""
    confidence: float = Field(3.0, gt=0)
    """Standard deviations by which a change must be sure; also the gate between agreement and contradiction."""
    alone: float = Field(5.0, gt=0)
    """Those by which a change must be sure that one camera alone has seen: a network is off by more than five of its
    sigmas about as often as noise is by more than three, and two cameras seldom in the same place."""
    min_area: float = Field(25.0, ge=0)
    """Square metres of connected change; less is left out."""
    reference_sigma: float = Field(0.3, gt=0)
    """Of the heights of the DEM and of the surface raster."""
    independent_after: float = Field(3600.0, gt=0)
    """Two looks of one camera are independent when they are that far apart."""
    settle: float = Field(600.0, ge=0)
    """Two cameras must agree over at least that long: what moves is gone by then."""
    repeated_error_share: float = Field(0.95, ge=0, le=1)
    """Of the variance of a depth, what each look of a camera has alike, which no number of them averages out. A network
    sees the same scene alike in any light; 0: depth whose errors are new each time, as a range finder's (then `alone`
    need not be more than `confidence`)."""
    memory: float = Field(8.0, ge=1)
    """Looks that a cell's mean remembers."""
    lasting: float = Field(365.0 * 86400.0, gt=0)
    """Time in which a look loses all but 1/e of its weight: over years, plants grow and rivers move their banks."""
    tallest: float = Field(60.0, gt=0)
    """Nothing on the ground is higher: smoke, birds and aircraft are."""
    register_frames: bool = True
    """Turn each frame, within its pose's uncertainty, so that it agrees best with the reference."""
    cache_mb: float = Field(100.0, ge=32)
    """Memory for cells; the others wait in the store."""
    trace_confirmed: bool = False
    """Trace depth, and export heights, to the surface as views have confirmed it; False: to `dem` and `surface` as
    they were given. Needs a folder for the node's state."""
    confirm_every: float = Field(600.0, ge=0)
    """Of the frames' time: a new version of the confirmed surface follows the one before after so long at the
    earliest."""
    views_mb: float = Field(34.0, ge=0)
    """Memory for what the reference shows in the pixels of cameras that stand still: 17 MB each at 1080p."""
