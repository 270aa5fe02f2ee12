"""Compare a photo's skyline with the terrain's horizon at every azimuth of a grid; pitch and roll are fitted robustly.

A column's misfit is a mixture: Student's t (four degrees of freedom) about the horizon, or anything (a tree, a mast).
The cost is minus its logarithm over that of "anything", so that a horizon which explains nothing gains nothing, be it
ever so uncertain. Where land beyond the DEM may stand over the horizon, that is the skyline as often as not, and else
all skylines between it and the bound of that land are alike likely. Where trees on a nearer crest may hide the horizon,
either is what is seen. Neighbouring columns are alike: all of an image count as a few, and in the fit and its
covariance those within one correlation length of a crest count as one."""

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.image_edges import ImageSkyline
from ltm_core.pose_estimation.skyline.picture_pose_config import SkylineErrors, farness
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon

_STARTS = np.array([0.2, 0.35, 0.5, 0.65, 0.8])
_ROUNDS = np.array([6.0, 3.0, 1.5, 1.0, 1.0])  # factors by which sigmas are widened in the rounds of the robust fit

# Columns of the photo's skyline, one row for each image column.
AWAY, TANGENT = 0, 1  # azimuth from the optical axis (rad), tangent of the elevation
BY_PITCH, BY_ROLL = 2, 3  # change of the tangent per radian of pitch and of roll
EDGE_SIGMA = 4  # standard deviation of the edge, as a tangent
NEAR_HEIGHT, NEAR_SIGMA, FAR_HEIGHT, FAR_SIGMA = 5, 6, 7, 8  # what grows on a near and on a far crest (m)
# Columns of the terrain's horizon, one row for each azimuth.
H_TANGENT, H_RANGE, H_CELL, H_BOUND = 0, 1, 2, 3  # tangent, range and cell size (m), bound of land beyond the DEM
FRONT_TANGENT, FRONT_RANGE = 4, 5  # of a nearer crest, whose trees may hide the horizon
H_FARNESS, FRONT_FARNESS = 6, 7  # weight of far cover, 0 to 1
# Columns of the result, one row for each azimuth of the grid.
COST, PITCH, ROLL = 0, 1, 2


def search_azimuths(
    skyline: ImageSkyline,
    camera: Camera,
    prior: PosePrior,
    horizon: TerrainHorizon,
    azimuths: Float64Array,
    position_sigma: float,
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the costs of azimuths (Y,), radians, of an undistorted camera with the tilt of the prior pose, and the
    pitch and roll to add to it, radians. `position_sigma`: metres."""
    _, pitch, roll = prior.pose.angles_deg
    x, y = (skyline.u - camera.cx) / camera.fx, (skyline.v - camera.cy) / camera.fy
    rays = np.column_stack([x, y, np.ones(len(x))])
    away, tangent = _level(rays, pitch, roll)
    small = 0.05
    by_pitch = (_level(rays, pitch + small, roll)[1] - tangent) / np.radians(small)
    by_roll = (_level(rays, pitch, roll + small)[1] - tangent) / np.radians(small)
    near, far = horizon.cover.near[skyline.cover], horizon.cover.far[skyline.cover]
    columns = np.column_stack([away, tangent, by_pitch, by_roll, skyline.sigma_px / camera.fy, near, far])
    step = float(azimuths[1] - azimuths[0]) if len(azimuths) > 1 else 0.0
    h, share = horizon, column_weight(skyline, camera, SkylineErrors.independent)
    crests = [h.tangent, h.range, h.cell, h.bound, h.front_tangent, h.front_range]
    crests += [farness(h.range), farness(h.front_range)]
    setting = np.array([step / 3.5, position_sigma, *prior.sigmas[4:], skyline.spacing / camera.fx])
    c = SkylineErrors
    noise = np.array([c.dem_sigma, c.cell_share, c.cell_lift, c.correlation, c.odds, share, c.own_crest])
    out = _search(columns, np.column_stack(crests), h.start, h.step, h.whole, azimuths, setting, noise)
    return out[:, COST], out[:, PITCH], out[:, ROLL]


def column_weight(skyline: ImageSkyline, camera: Camera, independent: float) -> float:
    """Return the weight of one column of an image whose columns count as `independent` altogether."""
    return min(1.0, independent * skyline.spacing / camera.width)


def _level(rays: Float64Array, pitch_deg: float, roll_deg: float) -> tuple[Float64Array, Float64Array]:
    """Return the azimuth from the optical axis' and tangent of optical rays (K, 3)."""
    x, y, z = (rays @ Pose.from_angles((0.0, 0.0, 0.0), 0.0, pitch_deg, roll_deg).rotation.T).T
    return np.arctan2(x, y), z / np.hypot(x, y)


@helper(inline="always")
def _cover(column: Float64Array, far: float) -> tuple[float, float]:
    """Return the height and sigma of what grows on a crest so far away; `CrestCover.at`, compiled."""
    near = 1 - far
    return near * column[NEAR_HEIGHT] + far * column[FAR_HEIGHT], near * column[NEAR_SIGMA] + far * column[FAR_SIGMA]


@helper(inline="always")
def _student(z: float) -> float:
    """Return Student's density with four degrees of freedom, over that at 0."""
    q = 1 + z * z / 4
    return float(1 / (q * q * np.sqrt(q)))


@kernel(nogil=True)
def _search(
    columns: Float64Array,
    horizon: Float64Array,
    start: float,
    step: float,
    whole: bool,
    azimuths: Float64Array,
    setting: Float64Array,
    noise: Float64Array,
) -> Float64Array:
    out = np.zeros((len(azimuths), 3))
    count = len(columns)
    total = len(horizon)
    half_step, position_sigma, pitch_sigma, roll_sigma, spacing = setting
    dem_sigma, cell_share, cell_lift, correlation, odds, share, own = noise
    error, sigma = np.empty(count), np.empty(count)
    gap, weight = np.empty(count), np.empty(count)
    front, front_sigma = np.empty(count), np.empty(count)
    for j in range(len(azimuths)):
        # Each image column's misfit to the horizon, with its standard deviation and weight.
        for k in range(count):
            x = (columns[k, AWAY] + azimuths[j] - start) / step
            if whole:
                x -= np.floor(x / total) * total
            i = int(x)
            weight[k] = 0.0
            if x < 0 or (i + 1 >= total and not whole):
                continue
            i1 = i + 1 if i + 1 < total else 0
            part = x - i
            # The range is that of the nearer one: at a step between two crests no mean of both.
            r = min(horizon[i, H_RANGE], horizon[i1, H_RANGE])
            if not r > 0.0:
                continue
            t = (1 - part) * horizon[i, H_TANGENT] + part * horizon[i1, H_TANGENT]
            slope = (horizon[i1, H_TANGENT] - horizon[i, H_TANGENT]) / step
            cell = cell_share * horizon[i, H_CELL]
            far = horizon[i, H_FARNESS] if horizon[i, H_RANGE] <= horizon[i1, H_RANGE] else horizon[i1, H_FARNESS]
            height, cover_sigma = _cover(columns[k], far)
            rise = height + cell_lift * horizon[i, H_CELL]
            error[k] = columns[k, TANGENT] - t - rise / r
            s = dem_sigma**2 + cover_sigma**2 + cell * cell + position_sigma**2
            sigma[k] = np.sqrt(columns[k, EDGE_SIGMA] ** 2 + (slope * half_step) ** 2 + s / (r * r))
            gap[k] = max(0.0, max(horizon[i, H_BOUND], horizon[i1, H_BOUND]) - t - rise / r)
            weight[k] = min(share, spacing * r / correlation)
            # The same for a nearer crest whose trees may hide the horizon.
            front_sigma[k] = 0.0
            r = horizon[i, FRONT_RANGE]
            if r > 0.0:
                height, cover_sigma = _cover(columns[k], horizon[i, FRONT_FARNESS])
                front[k] = columns[k, TANGENT] - horizon[i, FRONT_TANGENT] - height / r
                s = dem_sigma**2 + cover_sigma**2 + position_sigma**2
                front_sigma[k] = np.sqrt(columns[k, EDGE_SIGMA] ** 2 + (0.5 * step) ** 2 + s / (r * r))
        used = np.flatnonzero(weight > 0)
        if len(used) < 8:
            continue
        # Robust fits of pitch and roll, from several starts; the cheapest is kept.
        ordered = np.sort(error[used])
        best = np.inf
        for begin in range(len(_STARTS) + 1):
            # A change of pitch moves the skyline by about the same angle.
            a = 0.0 if begin == len(_STARTS) else -ordered[int(_STARTS[begin] * (len(used) - 1))]
            if abs(a) > 4 * pitch_sigma:
                continue
            b = 0.0
            for wide in _ROUNDS:
                paa, pab, pbb = 1 / pitch_sigma**2, 0.0, 1 / roll_sigma**2
                pa, pb = 0.0, 0.0
                for n in range(used.size):
                    k = int(used[n])
                    turn = a * columns[k, BY_PITCH] + b * columns[k, BY_ROLL]
                    e = error[k] + turn
                    free = e if e < 0 else max(0.0, e - gap[k])
                    s = sigma[k] * wide
                    # Towards the nearer end of what fits: the horizon, or the bound above it.
                    target = error[k] if e < 0 else error[k] - gap[k]
                    if gap[k] > 0 and e > 0:
                        if own / s * _student(e / s) > (1 - own) / (s + 0.375 * gap[k]):
                            free, target = e, error[k]
                        elif free == 0.0:
                            continue
                    like, off = odds / s * _student(free / s), free
                    if front_sigma[k] > 0.0:
                        s2 = front_sigma[k] * wide
                        other = odds / s2 * _student((front[k] + turn) / s2)
                        if other > like:
                            like, s, off, target = other, s2, front[k] + turn, front[k]
                    w = weight[k] * like / (1 + like) * 1.25 / (1 + off * off / (4 * s * s)) / (s * s)
                    paa += w * columns[k, BY_PITCH] ** 2
                    pab += w * columns[k, BY_PITCH] * columns[k, BY_ROLL]
                    pbb += w * columns[k, BY_ROLL] ** 2
                    pa -= w * columns[k, BY_PITCH] * target
                    pb -= w * columns[k, BY_ROLL] * target
                d = paa * pbb - pab * pab
                a, b = (pbb * pa - pab * pb) / d, (paa * pb - pab * pa) / d
            # The cost of the fit: minus the logarithm of the mixture's likelihood.
            cost = 0.5 * (a / pitch_sigma) ** 2 + 0.5 * (b / roll_sigma) ** 2
            for n in range(used.size):
                k = int(used[n])
                turn = a * columns[k, BY_PITCH] + b * columns[k, BY_ROLL]
                e = error[k] + turn
                free = e if e < 0 else max(0.0, e - gap[k])
                like = odds / (sigma[k] + 0.375 * gap[k]) * _student(free / sigma[k])
                if gap[k] > 0:
                    like = (1 - own) * like + own * odds / sigma[k] * _student(e / sigma[k])
                if front_sigma[k] > 0.0:
                    like = 0.5 * (like + odds / front_sigma[k] * _student((front[k] + turn) / front_sigma[k]))
                cost -= share * np.log(1 + like)
            if cost < best:
                best = cost
                out[j, COST], out[j, PITCH], out[j, ROLL] = cost, a, b
    return out
