"""Locate marks in the images of one or several cameras: from sightings to a posterior over the map.

For a place x, camera c and its marked direction m_c (`directions`), with the chance that a plume is higher than h,
S(h) = exp(-h / plume_height), and the chance to notice a fire at range r, D(r) = 1 / (1 + (r / detection_range)^2):

    p(x | m) ~ S(max_c lift_c(x)) prod_c D(r_c(x)) p(m_c | x)

The prior is flat over the ground. Densities of sightings of one camera, and of cameras that look in one direction, are
averaged geometrically, because they share errors. The cameras disagree if the evidence that one of them is turned
exceeds that of none by `wrong_odds`; the answer is then the mixture of what the others say without each.

`misfit` is T = -2 log of S and of the densities at the best place, each over the greatest that it could have."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy  # loads its parts when they are first used

from ltm_core.base.errors import RegionError
from ltm_core.base.types import BoolArray, Float64Array, Int32Array
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.locating.directions import OTHER_SLOPE
from ltm_core.locating.fusion import Fused, fused_closely, mixture
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import LocatingTerrain, Sighting
from ltm_core.raster.dem import Dem


@dataclass(frozen=True)
class Ellipse:
    """Ellipse. `centre`: x, y. `major`, `minor`: half axes, metres. `azimuth_deg`: of the major one."""

    centre: tuple[float, float]
    major: float
    minor: float
    azimuth_deg: float

    def outline(self, count: int = 72) -> Float64Array:
        """Return (count + 1, 2) x, y of the closed outline, counter-clockwise."""
        angle, azimuth = np.linspace(0, 2 * np.pi, count + 1)[:, None], math.radians(self.azimuth_deg)
        along = np.array([math.sin(azimuth), math.cos(azimuth)])
        around = self.major * np.cos(angle) * along + self.minor * np.sin(angle) * [-along[1], along[0]]
        return np.asarray(around + np.array(self.centre), np.float64)


@dataclass(frozen=True)
class Mode:
    """Connected part of the densest region. `share`: of all probability. `centre`: its mean, x, y."""

    share: float
    centre: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Posterior:
    """Probability of cells; all others have none. `geometry`: their raster in the map frame. `rows`, `cols`: (N,)
    int32. `probability`: (N,) float64, sums to 1, most probable cell first."""

    geometry: GridGeometry
    rows: Int32Array
    cols: Int32Array
    probability: Float64Array

    @classmethod
    def of_raster(cls, raster: Float64Array, geometry: GridGeometry) -> "Posterior | None":
        """Return the posterior of densities (H, W), without cells below 1e-9 of the maximum; None if all are 0."""
        greatest = float(raster.max(initial=0.0))
        if not greatest > 0:
            return None
        rows, cols = np.nonzero(raster > 1e-9 * greatest)
        values = raster[rows, cols]
        order = np.argsort(-values, kind="stable")
        return cls(geometry, rows[order].astype(np.int32), cols[order].astype(np.int32), values[order] / values.sum())

    @cached_property
    def places(self) -> Float64Array:
        """Return the cell centres, (N, 2) x, y."""
        return np.column_stack(self.geometry.to_map(self.rows, self.cols))

    @cached_property
    def mean(self) -> tuple[float, float]:
        x, y = self.probability @ self.places
        return float(x), float(y)

    @cached_property
    def covariance(self) -> Float64Array:
        """Return the covariance (2, 2) in square metres, including the cells' own size."""
        off = self.places - np.array(self.mean)
        return np.asarray((off * self.probability[:, None]).T @ off + np.eye(2) * self.geometry.resolution**2 / 12)

    @property
    def sigma(self) -> float:
        """Return the root mean square distance to the mean in metres."""
        return math.sqrt(float(np.trace(self.covariance)))

    def ellipse(self, share: float) -> Ellipse:
        """Return the ellipse with the covariance's shape around the mean that contains `share` of the probability."""
        values, vectors = np.linalg.eigh(self.covariance)
        along = vectors[:, 1]
        azimuth = math.degrees(math.atan2(along[0], along[1])) % 180.0
        unit = Ellipse(self.mean, math.sqrt(float(values[1])), math.sqrt(float(values[0])), azimuth)
        reach = reach_in_ellipse(unit, self.places)
        order = np.argsort(reach)
        at = int(np.searchsorted(np.cumsum(self.probability[order]), share))
        # Where all is in a cell or two, their size decides, which the covariance holds.
        scale = max(float(reach[order[min(at, len(order) - 1)]]), 0.5 * math.sqrt(-2 * math.log1p(-share)))
        return Ellipse(unit.centre, unit.major * scale, unit.minor * scale, azimuth)

    def densest(self, share: float) -> BoolArray:
        """Return (N,) the cells of the smallest region with at least `share` of the probability."""
        before = np.concatenate([[0.0], np.cumsum(self.probability)[:-1]])
        return np.asarray(before < share)

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """Return the connected parts of the densest 95 %, most probable first; those below 1 % are dropped."""
        return self._parts(0.95)

    @cached_property
    def likeliest(self) -> tuple[float, float]:
        """Return the mean x, y of the likeliest part of the densest half; the mean of all may lie between places."""
        return self._parts(0.5)[0].centre

    def _parts(self, share: float) -> tuple[Mode, ...]:
        """Return the connected parts of the densest region."""
        chosen = self.densest(share)
        rows, cols, probability = self.rows[chosen], self.cols[chosen], self.probability[chosen]
        top, left = int(rows.min()), int(cols.min())
        mask = np.zeros((int(rows.max()) - top + 1, int(cols.max()) - left + 1), np.bool_)
        mask[rows - top, cols - left] = True
        # Cells with one empty cell between them belong together: rays sampled in steps leave such.
        labels, count = scipy.ndimage.label(scipy.ndimage.binary_dilation(mask, np.ones((3, 3))), np.ones((3, 3)))
        number = labels[rows - top, cols - left]
        places = self.places[chosen]
        sums = np.bincount(number, probability, count + 1)
        found = []
        for label in np.flatnonzero(sums >= min(0.01, sums.max())):
            here = number == label
            x, y = probability[here] @ places[here] / sums[label]
            found.append(Mode(float(sums[label]), (float(x), float(y))))
        return tuple(sorted(found, key=lambda mode: -mode.share))

    def raster(self) -> Float64Array:
        """Return the raster (H, W) of `geometry`."""
        full = np.zeros(self.geometry.shape)
        full[self.rows, self.cols] = self.probability
        return full


def reach_in_ellipse(ellipse: Ellipse, places: Float64Array) -> Float64Array:
    """Return the distance from the centre over that of the outline in the same direction, (N,)."""
    azimuth = math.radians(ellipse.azimuth_deg)
    along = np.array([math.sin(azimuth), math.cos(azimuth)])
    off = places - np.array(ellipse.centre)
    return np.asarray(
        np.hypot(off @ along / ellipse.major, (off[:, 0] * along[1] - off[:, 1] * along[0]) / ellipse.minor), np.float64
    )


def write_posterior(path: Path, posterior: Posterior, frame: SiteFrame) -> None:
    """Write the probability of each cell, float32, in the frame's CRS; 0 outside the posterior."""
    from ltm_core.raster.raster_io import write_geotiff

    geometry = posterior.geometry.translated(frame.x_origin, frame.y_origin, crs=frame.crs)
    write_geotiff(path, posterior.raster().astype(np.float32), geometry, nodata=0.0)


MOST_SIGHTINGS = 64
_NEGLIGIBLE = 0.02  # probability of a wrong camera below which the solution without it is ignored
_ELSEWHERE = 0.02 * OTHER_SLOPE / (2 * math.pi)  # density of marks of another object, by one in fifty wrong cameras


@dataclass(frozen=True)
class CameraAgreement:
    """Agreement of the cameras. `statistic`: log likelihood ratio of one wrong camera to none; +inf if no place fits
    all. `limit`: of it. `suspicion`: by camera, the probability that it is wrong if they disagree, else empty."""

    statistic: float
    limit: float
    suspicion: dict[str, float]

    @property
    def agree(self) -> bool:
        return not self.suspicion


@dataclass(frozen=True, eq=False)
class Location:
    """Result of `locate`. `posterior`: in the map frame; if cameras disagree, a mixture over the wrong camera.
    `misfit`: T at the best place, also of one camera's sightings. `agreement`: None with one camera. `lift`: metres
    above the ground from which the camera with the worst view sees smoke, mean over the posterior."""

    posterior: Posterior
    misfit: float
    agreement: CameraAgreement | None
    lift: float


@dataclass(frozen=True, eq=False)
class Locator:
    """Locator of marks on one terrain. `dem`: the visible surface in the frame of the poses. `bend`: of rays."""

    dem: Dem
    bend: float
    config: LocatingConfig = field(default_factory=LocatingConfig)

    def locate(self, sightings: Sequence[Sighting], smoke: bool = False) -> Location:
        """Locate the marked object by one or several sightings of it. `smoke`: its lowest visible part is marked, and
        its foot may be hidden; else it stands on the ground that is marked. Raises RegionError: no sighting, too many,
        one of sky or unknown terrain; PoseError for a camera under the ground or an invalid covariance."""
        if not 1 <= len(sightings) <= MOST_SIGHTINGS:
            raise RegionError(f"give 1 to {MOST_SIGHTINGS} sightings, got {len(sightings)}")
        terrain = LocatingTerrain(self.dem, self.bend, self.config, smoke)
        names = list(dict.fromkeys(sighting.name for sighting in sightings))
        sights = [terrain.look(sighting) for sighting in sightings]
        fused = fused_closely(terrain, sights)
        if len(names) == 1:
            return _location(fused, None)
        limit = math.log(self.config.wrong_odds)
        parted = [([s for s in sights if s.name != n], [s for s in sights if s.name == n]) for n in names]
        turned = [fused_closely(terrain, others, wrong) for others, wrong in parted]
        evidences = np.array([part.log_evidence for part in turned])
        statistic = math.inf
        if np.isfinite(fused.log_evidence):
            statistic = float(scipy.special.logsumexp(evidences)) - math.log(len(names)) - fused.log_evidence
        if not statistic > limit:
            return _location(fused, CameraAgreement(statistic, limit, {}))
        # What a wrong camera marks may be another thing, in any direction.
        without = [fused_closely(terrain, others) for others, _ in parted]
        elsewhere = np.array([part.log_evidence for part in without]) + math.log(_ELSEWHERE)
        both = np.logaddexp(evidences, elsewhere)
        # Equally likely before; where nothing is possible under any, still equal.
        chances = scipy.special.softmax(both if np.isfinite(both.max()) else np.zeros(len(names))).tolist()
        agreement = CameraAgreement(statistic, limit, dict(zip(names, chances, strict=True)))
        likely = [k for k, chance in enumerate(chances) if chance >= _NEGLIGIBLE]
        return _location(mixture([without[k] for k in likely], [chances[k] for k in likely]), agreement)

    @property
    def limit(self) -> float:
        """Return the maximum misfit of one camera's sightings of one object."""
        return float(scipy.special.chdtri(2, self.config.false_alarm))


def _location(fused: Fused, agreement: CameraAgreement | None) -> Location:
    posterior = Posterior.of_raster(fused.weight, fused.window)
    if posterior is None:
        raise RegionError("no place on the map fits all sightings; they show different objects")
    lift = float(posterior.probability @ fused.lift[posterior.rows, posterior.cols])
    return Location(posterior, fused.least, agreement, lift)
