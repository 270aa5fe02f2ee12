"""Configure the updated terrain of a site, and the errors of poses."""

import math

import numpy as np
from pydantic import Field

from ltm_core.base.strict_model import Expert, StrictModel
from ltm_core.base.types import Float64Array


class PoseErrorConfig(StrictModel):
    """Standard deviations of a pose without a covariance."""

    angle_deg: float = Field(0.3, gt=0)
    """Standard deviation of each angle in degrees, typical of surveyed mounts. A phone's compass is off by five degrees
    and must state so."""
    position: float = Field(0.5, gt=0)
    """Standard deviation of each coordinate in metres."""

    def covariance(self) -> Float64Array:
        """Return the covariance (6, 6): position, then rotation about the map's axes, in metres and radians."""
        return np.diag([self.position**2] * 3 + [math.radians(self.angle_deg) ** 2] * 3)


class TerrainConfig(StrictModel):
    """Settings of the updated terrain; a site with this section runs the node `terrain`. Lengths in metres, times in
    seconds."""

    resolution: float | None = Field(None, gt=0)
    """Cell size in metres; None: that of the DEM."""
    min_range: Expert[float] = Field(20.0, ge=0)
    """Minimum range in metres; anything nearer is ignored as an object close to the lens."""
    max_range: Expert[float] = Field(1500.0, gt=0)
    """Maximum range in metres; beyond it, depth is too coarse to update a cell."""
    columns: Expert[int] = Field(960, ge=1)
    """Maximum number of columns of an image that are used, evenly spaced; rows have the same spacing."""
    threshold: Expert[float] = Field(1.5, gt=0)
    """Minimum change of height in metres to report."""
    confidence: Expert[float] = Field(3.0, gt=0)
    """Standard deviations by which a change must be significant; also the gate between agreement and contradiction."""
    alone: Expert[float] = Field(5.0, gt=0)
    """Standard deviations by which a change that only one camera has seen must be significant. A network is off by more
    than five of its sigmas about as often as noise is by more than three, and two cameras seldom err in the same place.
    """
    min_area: Expert[float] = Field(25.0, ge=0)
    """Minimum area of a connected change in square metres."""
    reference_sigma: Expert[float] = Field(0.3, gt=0)
    """Standard deviation of the heights of the DEM and of the surface raster in metres."""
    independent_after: Expert[float] = Field(3600.0, gt=0)
    """Seconds after which two observations by one camera are independent."""
    settle: Expert[float] = Field(600.0, ge=0)
    """Minimum seconds over which two cameras must agree, so that moving objects are gone."""
    repeated_error_share: Expert[float] = Field(0.95, ge=0, le=1)
    """Share of the variance of a depth that all observations of one camera have in common and that no averaging
    reduces. A network makes the same error in any light; 0: errors are new each time, as with a range finder (then
    `alone` need not exceed `confidence`)."""
    memory: Expert[float] = Field(8.0, ge=1)
    """Number of observations that a cell's mean remembers."""
    lasting: Expert[float] = Field(365.0 * 86400.0, gt=0)
    """Seconds in which an observation's weight falls to 1/e; over years, plants grow and rivers move their banks."""
    tallest: Expert[float] = Field(60.0, gt=0)
    """Maximum height of objects on the ground in metres; anything higher is smoke, a bird or an aircraft."""
    register_frames: Expert[bool] = True
    """Whether to turn each frame, within its pose's uncertainty, to agree best with the reference."""
    cache_mb: Expert[float] = Field(100.0, ge=32)
    """Memory for cells in MB; other cells stay in the store."""
    trace_confirmed: bool = False
    """Whether depth is traced, and heights are exported, with the surface that views have confirmed; False: with `dem`
    and `surface` as given. Needs a folder for the node's state."""
    confirm_every: Expert[float] = Field(600.0, ge=0)
    """Minimum seconds of frame time between two versions of the confirmed surface."""
    views_mb: Expert[float] = Field(34.0, ge=0)
    """Memory in MB for the expected views of fixed cameras; a view takes 17 MB at 1080p."""
