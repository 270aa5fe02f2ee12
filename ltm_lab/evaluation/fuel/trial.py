"""Trials of the fuel map: simulated votes of towers over terrain of known cover, under chosen errors.

Pixels are traced over the terrain with each frame's true pose to find what they show; the network's errors are drawn
for them; and they are voted with the pose that is believed. Only that is simulated: votes, evidence and majority are
the system's own. `ltm-lab eval fuel` runs the trials."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.special import ndtr

from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.votes import CellVotes, VoteCaster
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.fuel.trial_clumping import Clumping, clumping_of, correlation_of
from ltm_lab.evaluation.fuel.trial_country import CAMERA, REACH, SUBCELLS, View, World, tower_views

TUNING_SEEDS = (101, 102)
"""Of the countries on which the constants of `FusionRules` were chosen; scores are of others."""
BEGIN_NS = 1_750_000_000 * 10**9
_CLUMP_PX = 6.0
"""Of the errors of a frame, standard deviation of the Gaussian that makes neighbours err together."""
MODERATE = Clumping()
SYSTEMATIC = Clumping(network=0.3, view=0.3, frame=0.2)
SLOPES = Clumping(network=0.2, view=0.2, frame=0.3, stand_m=120.0)


@dataclass(frozen=True)
class Trial:
    """Errors and conditions of a trial.

    `pose_deg`: root mean square of the rotation by which a pose is wrong, about any axis; half of its variance is the
    same in all frames of a view. `clumping`: of the network's errors; None: as its known correlations say.
    `network_error`: relative difference of the network in the field from what is known of it. `prior_wrong`: share of
    wrong cells of the prior, in patches. `near`: one more camera, low among the plants, which takes each third pixel
    for trees. `hours`: when each view is taken. `telling`: wrong labels are less confident. `measured`: the network's
    errors are known; else they are measured on the trial's own votes, as `ltm models measure` does."""

    name: str
    pose_deg: float = 0.0
    clumping: Clumping | None = MODERATE
    network_error: float = 0.15
    prior_wrong: float = 0.05
    near: bool = False
    telling: bool = True
    measured: bool = True
    has_prior: bool = True
    hours: tuple[float, ...] = (0.0, 1.0)

    def clumped(self, errors: LabelErrors) -> Clumping:
        return clumping_of(errors) if self.clumping is None else self.clumping

    def known(self, errors: LabelErrors) -> LabelErrors:
        """What an evaluation of the network tells of its errors: their shares, and how they correlate in this trial."""
        return LabelErrors(errors.shares, correlation_of(self.clumped(errors), errors), errors.source)


TRIALS = (
    Trial("exact poses"),
    Trial("pose 1 deg", pose_deg=1.0),
    Trial("stands mislabelled", clumping=SYSTEMATIC),
    Trial("stands mislabelled as surely", clumping=SYSTEMATIC, telling=False),
    Trial("unmeasured network", clumping=SYSTEMATIC, telling=False, measured=False),
    Trial("slopes mislabelled", clumping=SLOPES),
    Trial("errors as measured", clumping=None),
    Trial("a near camera dominates", near=True),
    Trial("outdated prior", prior_wrong=0.2),
    Trial("no prior", has_prior=False),
    Trial("all of it", pose_deg=1.0, clumping=SYSTEMATIC, near=True, prior_wrong=0.1),
    Trial(
        "all of it, a week",
        pose_deg=1.0,
        clumping=SYSTEMATIC,
        near=True,
        prior_wrong=0.1,
        hours=(0, 1, 24, 48, 96, 168),
    ),
)


def frames(world: World, trial: Trial, errors: LabelErrors, labels: LabelSet, seed: int) -> Iterator[CellVotes]:
    """The votes of all frames in order of time: each tower looks in six directions, twice or as often as it says."""
    rng = np.random.default_rng([seed, 77])
    tracer = TerrainTracer(world.dem, possible=NOTHING_BEYOND)
    caster = VoteCaster(world.geometry, world.dem, labels.votes_table[: len(labels)], REACH, tracer.bend)
    views = tower_views(world.towers) + (_near_views(world) if trial.near else [])
    each = trial.pose_deg / np.sqrt(3)  # of three angles, for a rotation of that much
    sigma = np.radians(each)
    covariance = np.diag([0.0, 0.0, 0.0, sigma**2, sigma**2, sigma**2]) if sigma else None
    lasting = rng.normal(0, each / np.sqrt(2), (len(views), 3))
    network = _Network(world, trial, errors, rng)
    for hour in trial.hours:
        for view, (name, position, azimuth, pitch) in enumerate(views):
            passing = rng.normal(0, each / np.sqrt(2), 3)
            turn = lasting[view] + passing
            believed = Pose.from_angles(position, azimuth, pitch)
            true = Pose.from_angles(position, azimuth + turn[0], pitch + turn[1], turn[2]) if sigma else believed
            shown = tracer.trace(CAMERA, true)
            label, confidence = network.labels(shown.points(), name)
            ranges = (shown if believed is true else tracer.trace(CAMERA, believed)).range
            stamp_ns = int(BEGIN_NS + hour * 3600e9)
            yield caster.cast(
                ranges, CAMERA, believed, label, stamp_ns, name, confidence, covariance, along_axis=False
            )  # fmt: skip


class _Network:
    """Draws a network's labels of pixels: a Gaussian copula, so that the shares of labels are those of its confusion in
    the field, and stands, clumps and neighbours err together as the trial says."""

    def __init__(self, world: World, trial: Trial, errors: LabelErrors, rng: np.random.Generator) -> None:
        self._world, self._clumping, self._rng = world, trial.clumped(errors), rng
        self._telling = trial.telling
        table = _in_the_field(errors, trial.network_error, rng)
        # The commonest answer first, so that errors share their places.
        self._order = np.argsort(-table, axis=1, kind="stable")
        self._cumulative = np.cumsum(np.take_along_axis(table, self._order, axis=1), axis=1)
        self._entropy = int(rng.integers(2**31))
        self._stands: dict[str, Float32Array] = {}
        cell = world.geometry.resolution / SUBCELLS
        rows, cols = world.fine.shape
        self._geometry = GridGeometry(world.geometry.x_min, world.geometry.y_max, cell, cols, rows)

    def labels(self, points: Float32Array, camera: str) -> tuple[UInt8Array, UInt8Array]:
        """Label and confidence images of what the pixels see, (H, W, 3) map points."""
        seen = np.isfinite(points[..., 0])
        row, col = self._geometry.cell_of(np.where(seen, points[..., 0], 0), np.where(seen, points[..., 1], 0))
        seen &= self._geometry.contains(row, col)
        row, col = np.where(seen, row, 0), np.where(seen, col, 0)
        true = self._world.fine[row, col].astype(np.int64) - 1
        shares, rng = self._clumping, self._rng
        clumps = _normalised(ndimage.gaussian_filter(rng.standard_normal(true.shape, np.float32), _CLUMP_PX))
        own = rng.standard_normal(true.shape, np.float32)
        chance = ndtr(
            np.sqrt(shares.network) * self._stand("")[row, col]
            + np.sqrt(shares.view) * self._stand(camera)[row, col]
            + np.sqrt(shares.frame) * clumps
            + np.sqrt(shares.own) * own
        )
        rank = (chance[..., None] > self._cumulative[true]).sum(axis=-1)
        last = self._order.shape[1] - 1
        shown = np.take_along_axis(self._order[true], np.minimum(rank, last)[..., None], axis=-1)[..., 0]
        if camera == _NEAR:
            shown = np.where(clumps > 0.43, LifeForm.TREE - 1, shown)
        told = chance if self._telling else ndtr(rng.standard_normal(true.shape, np.float32))
        confidence = np.clip(0.95 - 0.5 * told + 0.05 * own, 0.3, 1.0)
        return np.where(seen, shown + 1, 0).astype(np.uint8), (confidence * 255).astype(np.uint8)

    def _stand(self, camera: str) -> Float32Array:
        """Where a camera, or whoever looks (no camera), errs by stands, on the grid of subcells."""
        if camera not in self._stands:
            rng = np.random.default_rng([self._entropy, zlib.crc32(camera.encode())])
            sigma = self._clumping.stand_m / self._geometry.resolution
            drawn = ndimage.gaussian_filter(rng.standard_normal(self._world.fine.shape, np.float32), sigma, mode="wrap")
            self._stands[camera] = _normalised(drawn)
        return self._stands[camera]


def _normalised(values: Float32Array) -> Float32Array:
    return np.asarray(values / values.std(), np.float32)


def _in_the_field(errors: LabelErrors, relative: float, rng: np.random.Generator) -> Float64Array:
    """(FORMS, FORMS) shares that differ from what is known of the network."""
    table = np.where(np.isnan(errors.shares), np.eye(len(errors.shares)), errors.shares)
    wrong = table * np.exp(rng.normal(0, 2 * relative, table.shape))
    np.fill_diagonal(wrong, np.diagonal(table) * np.exp(rng.normal(0, relative / 2, len(table))))
    return np.asarray(wrong / wrong.sum(axis=1, keepdims=True))


_NEAR = "near"


def _near_views(world: World) -> list[View]:
    x, y, _ = world.towers[0]
    place = (x + 400.0, y - 250.0)
    height = float(world.dem.elevation_at(*place)) + 6.0
    return [(_NEAR, (*place, height), azimuth, -4.0) for azimuth in (45.0, 225.0)]
