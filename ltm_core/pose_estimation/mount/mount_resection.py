"""Calibrate a PTZ mount from landmarks marked in images of several presets.

Shared by all images are the mount's rotation, the zero of its tilt axis and its place, and where asked for a factor
of the focal length at each zoom; each preset has its own error of the encoders. From a start in closed
form (`closed_forms`), least squares in the image, as in `resection`."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its parts when they are first used

from ltm_core.base.errors import PoseError
from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.geometry.pose import Pose, matrix_of_angles
from ltm_core.geometry.zoom_lens import ZoomLens
from ltm_core.pose_estimation.lens import LensPrior
from ltm_core.pose_estimation.mount.mount_model import MountModel, Sign, ptz_angles
from ltm_core.pose_estimation.points.control_points import PtzPoints
from ltm_core.pose_estimation.points.resection_adjustment import MAX_OUTLIER_SHARE, OUTLIER_SIGMAS, REMEDY, named
from ltm_core.pose_estimation.skyline.pose_prior import turned
from ltm_core.visibility.footprint import line_of_sight_vectors, pixel_rays

LEAST_LANDMARKS = 4
"""Minimum number of landmarks. With two, the lean of the mount and the zero of its tilt cannot be separated; with
three, no error is detected."""
WORST_SIGMA_DEG = 0.3  # worst sigma of a direction on the circle for landmarks far enough apart in pan
_LEAN_SIGMA, _TILT_SIGMA, _FOCAL_SIGMA = math.radians(2.0), math.radians(2.0), 0.05
"""Weak priors on the lean of a mount, on its tilts and on a table's focal lengths, compared with four landmarks."""
Signs = tuple[Sign, Sign]  # of pan and tilt
_SIGN_GAIN = 3.0  # factor by which another sign of an axis must fit the landmarks better than the stated one


@dataclass(frozen=True, eq=False)
class MountResection:
    """`residuals`: (N, 2) pixels, marked minus projected; `used`: (N,) those that were not outliers; `sigma_px`: of a
    measured coordinate. `worst`: pan (deg) at which the calibration leaves the direction most open, and its standard
    deviation (deg). `focal_factors`: by zoom, with which the stated lens was multiplied, and `focal_sigmas` theirs.
    `notes`: what a user must know."""

    points: PtzPoints
    model: MountModel
    lens: ZoomLens
    residuals: Float64Array
    used: BoolArray
    sigma_px: float
    worst: tuple[float, float]
    focal_factors: dict[float, float]
    focal_sigmas: dict[float, float]
    notes: tuple[str, ...]


def resect_mount(
    points: PtzPoints,
    start: MountModel,
    lens: ZoomLens,
    bend: float = 0.0,
    free_focal: bool = True,
    free_position: bool = False,
    sigma_px: float = 1.0,
    free_k1: bool = False,
) -> MountResection:
    """Fit the mount to landmarks. Raises PoseError that names the points.

    `points`: at least four landmarks, spread in pan. `start`: its place, lean, signs and sigmas; its azimuth is not
    used. `bend`: `geodesy.ray_bend`. `free_focal`: fit the lens at each zoom, within some 5 percent. `free_position`:
    fit the place too, within the sigmas of `start`. `sigma_px`: minimum of a mark. `free_k1`: fit k1 at each zoom."""
    count = len(np.unique(points.places, axis=0))
    if count < LEAST_LANDMARKS:
        raise PoseError(
            f"{count} landmarks: a mount needs at least {LEAST_LANDMARKS} different ones, spread in pan: with fewer, "
            "its lean and the zero of its tilt cannot be separated"
        )
    outside = (points.pixels < -0.5) | (points.pixels > np.array([lens.width, lens.height]) - 0.5)
    if outside.any():
        names = ", ".join(np.array(points.names)[outside.any(axis=1)])
        raise PoseError(f"landmarks outside the {lens.width} x {lens.height} image: {names}")
    problem = _Adjustment(points, start, lens, bend, free_focal, free_position, sigma_px, free_k1)
    stated = (start.pan_sign, start.tilt_sign)
    fits: dict[Signs, tuple[float, MountModel, Float64Array]] = {}
    for signs, model in closed_forms(points, start, lens, bend).items():
        median, state = problem.robust_fit(model)
        fits[signs] = median, model, state
        if signs == stated and median <= 3 * sigma_px:
            break
    if not fits:
        raise PoseError(
            f"no mount within {math.degrees(STEEPEST_LEAN):.0f} deg of the stated lean fits the landmarks. " + REMEDY
        )
    best = min(fits, key=lambda signs: fits[signs][0])
    if stated in fits and fits[stated][0] <= _SIGN_GAIN * max(fits[best][0], sigma_px):
        best = stated
    _, model, state = fits[best]
    found = problem.solved(model, state)
    axes = [name for name, x, y in zip(("pan", "tilt"), best, stated, strict=True) if x != y]
    if not axes:
        return found
    note = f"{' and '.join(axes)} has the opposite sign of the stated one: only so do the landmarks fit"
    return replace(found, notes=(note, *found.notes))


class _Adjustment:
    """Least squares. The state: shift (3), rotation about the map's axes (3), tilt zero, log focal factors a zoom,
    changes of k1 a zoom, encoder errors of pan and tilt a preset."""

    def __init__(
        self,
        points: PtzPoints,
        start: MountModel,
        lens: ZoomLens,
        bend: float,
        free_focal: bool,
        free_position: bool,
        sigma_px: float,
        free_k1: bool,
    ) -> None:
        self._points, self._start, self._lens, self._bend = points, start, lens, bend
        self._sigma_px = sigma_px
        self._presets, self._preset_of = np.unique(points.readings, axis=0, return_inverse=True)
        self._zooms, self._zoom_of = np.unique(points.readings[:, 2], return_inverse=True)
        self._cameras = [lens.camera(zoom) for zoom in self._zooms]
        place = np.sqrt(np.diag(start.covariance)[:3]) if free_position else np.zeros(3)
        focal = np.full(len(self._zooms), _FOCAL_SIGMA if free_focal else 0.0)
        radial = np.array([LensPrior.of("ptz", camera).k1 if free_k1 else 0.0 for camera in self._cameras])
        encoder = np.full(2 * len(self._presets), start.encoder_sigma)
        # The azimuth is what is sought; the lean is held weakly to what is stated, about level axes.
        self._prior = np.concatenate([place, [_LEAN_SIGMA, _LEAN_SIGMA, 0.0, _TILT_SIGMA], focal, radial, encoder])
        self._free = np.concatenate([place > 0, np.ones(4, bool), focal > 0, radial > 0, np.ones(len(encoder), bool)])

    def robust_fit(self, model: MountModel) -> tuple[float, Float64Array]:
        """Return the median residual (pixels) and the state of a robust fit from `model`."""
        self._begun = model
        state = np.zeros(int(self._free.sum()))
        everyone = np.ones(len(self._points.names), bool)
        for loss in ("soft_l1", "cauchy", "cauchy"):
            state, _ = self._least(state, everyone, loss, self._scale(state))
        return float(np.median(np.linalg.norm(self._residuals(state), axis=1))), state

    def solved(self, model: MountModel, state: Float64Array) -> MountResection:
        """Return the result from a robust fit: least squares over the landmarks without outliers."""
        self._begun = model
        names, used = self._points.names, np.ones(len(self._points.names), bool)
        for _ in range(10):
            off = np.linalg.norm(self._residuals(state), axis=1)
            now = off <= OUTLIER_SIGMAS * self._scale(state)
            if now.mean() < 1 - MAX_OUTLIER_SHARE or now.sum() < LEAST_LANDMARKS:
                raise PoseError(
                    f"{(~now).sum()} of {len(names)} landmarks do not fit a common mount: "
                    f"{named(names, off, ~now)}. {REMEDY}"
                )
            settled = bool((now == used).all())
            used = now
            state, jacobian = self._least(state, used, "linear", self._sigma_px)
            if settled:
                break
        return self._result(state, jacobian, used)

    def _result(self, state: Float64Array, jacobian: Float64Array, used: BoolArray) -> MountResection:
        focal = slice(7, 7 + len(self._zooms))
        # The encoders' errors are free, so that each preset takes up two coordinates of its own.
        bound = 7 - 3 * (not self._free[0]) + int(self._free[7 : 7 + 2 * len(self._zooms)].sum())
        spare = max(2 * int(used.sum()) - bound, 1)
        factor = max(1.0, float(np.linalg.norm(self._rows(state, used, self._sigma_px))) / math.sqrt(spare))
        inverse = np.zeros((len(self._prior), len(self._prior)))
        inverse[np.ix_(self._free, self._free)] = np.linalg.pinv(jacobian.T @ jacobian) * factor**2
        covariance = inverse[:7, :7]
        if not self._free[0]:
            covariance[:3, :3] = self._start.covariance[:3, :3]
        whole = self._whole(state)
        model = replace(self._model(whole), covariance=covariance)
        sigmas = {pan: model.direction_sigma_deg(pan) for pan in np.arange(0.0, 360.0, 10.0).tolist()}
        worst = max(sigmas, key=sigmas.__getitem__)
        lens, factors, deviations = self._lens, dict[float, float](), dict[float, float]()
        if self._free[focal].any():
            zooms = self._zooms.tolist()
            factors = dict(zip(zooms, np.exp(whole[focal]).tolist(), strict=True))
            deviations = dict(zip(zooms, np.sqrt(np.maximum(np.diag(inverse)[focal], 0.0)).tolist(), strict=True))
            lens = lens.scaled(factors, dict(zip(zooms, whole[focal.stop :].tolist(), strict=False)))
        notes: tuple[str, ...] = ()
        if sigmas[worst] > WORST_SIGMA_DEG:
            pans = np.sort(self._points.readings[used, 0] % 360.0)
            span = 360.0 - float(np.diff(np.append(pans, pans[0] + 360.0)).max())  # the shortest arc that holds all
            notes = (
                f"the landmarks span {span:.0f} deg of pan only: at pan {worst:.0f} the direction is uncertain by "
                f"{sigmas[worst]:.2f} deg; mark some there",
            )
        at_worst, sigma_px = (worst, sigmas[worst]), self._sigma_px * factor
        residuals = self._residuals(state)
        return MountResection(
            self._points, model, lens, residuals, used, sigma_px, at_worst, factors, deviations, notes
        )

    def _whole(self, state: Float64Array) -> Float64Array:
        whole = np.zeros(len(self._prior))
        whole[self._free] = state
        return whole

    def _model(self, whole: Float64Array) -> MountModel:
        return replace(self._begun, base=turned(self._begun.base, whole[3:6], whole[:3]), tilt_zero=float(whole[6]))

    def _residuals(self, state: Float64Array) -> Float64Array:
        """Return (N, 2) pixels; a constant for a landmark behind the camera, which keeps it from pulling."""
        whole = self._whole(state)
        model = self._model(whole)
        zooms, presets = len(self._zooms), len(self._presets)
        told = np.radians(self._presets[:, :2]) * (model.pan_sign, model.tilt_sign) + (0.0, model.tilt_zero)
        angles = told + whole[7 + 2 * zooms :].reshape(presets, 2)
        rotations = model.base.rotation @ matrix_of_angles("YX", angles)
        sights = line_of_sight_vectors(model.base.position, self._points.places, self._bend)
        seen = np.einsum("ni,nij->nj", sights, rotations[self._preset_of])
        residuals = np.empty((len(sights), 2))
        for k, camera in enumerate(self._cameras):
            factor = math.exp(whole[7 + k])
            mine = self._zoom_of == k
            k1, k2, p1, p2, k3 = camera.distortion
            bent = k1 + float(whole[7 + zooms + k]), k2, p1, p2, k3
            zoomed = replace(camera.zoomed(factor), distortion=bent)
            residuals[mine] = self._points.pixels[mine] - zoomed.project(seen[mine])
        return np.nan_to_num(residuals, nan=2.0 * self._lens.width)

    def _rows(self, state: Float64Array, used: BoolArray, sigma_px: float) -> Float64Array:
        whole = self._whole(state)
        base = turned(self._begun.base, whole[3:6])
        down, stated = base.rotation[:, 1], self._start.base.rotation[:, 1]
        lean = np.cross(stated, down)[:2] / _LEAN_SIGMA
        held = self._free & (self._prior > 0)
        held[3:6] = False
        return np.concatenate([self._residuals(state)[used].ravel() / sigma_px, lean, whole[held] / self._prior[held]])

    def _scale(self, state: Float64Array) -> float:
        """Of the marks, from the median of all, but no less than what a mark is worth at best."""
        off = np.linalg.norm(self._residuals(state), axis=1)
        return max(self._sigma_px, float(np.median(off)) / 1.1774)

    def _least(
        self, state: Float64Array, used: BoolArray, loss: str, sigma_px: float
    ) -> tuple[Float64Array, Float64Array]:
        """Return the state of least cost, and the slopes of the rows there."""
        solved = scipy.optimize.least_squares(
            lambda x: self._rows(x, used, sigma_px), state, jac="2-point", x_scale="jac", loss=loss, max_nfev=60
        )
        return solved.x, solved.jac


STEEPEST_LEAN = math.radians(20.0)  # maximum lean of a mount from its stated orientation
_REACHED = 3  # number of landmarks that must fit the mount of a pair before it is fitted to all of them
_MOST_PAIRS = 200


def closed_forms(points: PtzPoints, start: MountModel, lens: ZoomLens, bend: float) -> dict[Signs, MountModel]:
    """Return, for each sign of pan and tilt, the stated ones first, the mount that most landmarks agree on."""
    sights = line_of_sight_vectors(start.base.position, points.places, bend)
    sights /= np.linalg.norm(sights, axis=1, keepdims=True)
    cameras = [lens.camera(zoom) for zoom in points.readings[:, 2]]
    rays = np.array([pixel_rays(c, p[None])[0] for c, p in zip(cameras, points.pixels, strict=True)])
    either: Signs = (1, -1)
    found = {}
    for pan, tilt in sorted(itertools.product(either, either), key=lambda s: s != (start.pan_sign, start.tilt_sign)):
        turns = matrix_of_angles("YX", [ptz_angles(p, t, pan, tilt) for p, t, _ in points.readings])
        best = _best_rotation(np.einsum("nij,nj->ni", turns, rays), sights, start)
        if best is not None:
            base = Pose(start.base.position, best)
            found[pan, tilt] = replace(start, base=base, tilt_zero=0.0, pan_sign=pan, tilt_sign=tilt)
    return found


def _best_rotation(in_ptz: Float64Array, sights: Float64Array, start: MountModel) -> Float64Array | None:
    """Return the rotation of the mount with the least median angle: from a pair of landmarks, then from all that fit
    this; None if all lean too far."""

    def off(rotation: Float64Array) -> Float64Array:
        cosine = np.einsum("ni,ni->n", in_ptz @ rotation.T, sights)
        return np.asarray(np.arccos(np.clip(cosine, -1, 1)), np.float64)

    pairs = np.array(list(itertools.combinations(range(len(sights)), 2)))
    best: tuple[float, Float64Array] | None = None
    for two in pairs[np.linspace(0, len(pairs) - 1, min(len(pairs), _MOST_PAIRS)).astype(int)]:
        if np.linalg.norm(np.cross(sights[two[0]], sights[two[1]])) < 0.01:
            continue
        rotation = scipy.spatial.transform.Rotation.align_vectors(sights[two], in_ptz[two])[0].as_matrix()
        near = off(rotation) <= max(2 * float(np.median(off(rotation))), math.radians(0.5))
        if near.sum() >= _REACHED:
            rotation = scipy.spatial.transform.Rotation.align_vectors(sights[near], in_ptz[near])[0].as_matrix()
        median = float(np.median(off(rotation)))
        lean = math.acos(float(np.clip(rotation[:, 1] @ start.base.rotation[:, 1], -1, 1)))
        if lean <= STEEPEST_LEAN and (best is None or median < best[0]):
            best = median, rotation
    return None if best is None else best[1]
