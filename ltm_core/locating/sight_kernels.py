"""Evaluate the likelihood of a mark along the rays of a fan, with plumes that drift.

Smoke is first seen at the highest of several slopes: the place's own ground or a crest close before it (`near`), and
the crests farther before it (`far`), whose heights have errors of their own. The density of the greatest of independent
normal variables is the sum of each one's, times the chance that all others are lower."""

import math

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float32Array, Float64Array, Int64Array
from ltm_core.locating.sight_fan import NO_LEVEL, Rays, SmokeDensities

CRESTS = 6  # maximum number of crests kept per ray: those that may be the highest
_STRETCH = 0.01  # share of the range within which errors of samples are fully correlated, however fine the raster is
_SPARSE = 4  # interval at which the visibility probability is computed among samples whose visibility is uncertain
FOREGROUND = 15.0  # metres of foreground
_SURE = 3.5  # number of sigmas from which one slope is higher than another
_UPPER = 2.0  # sigmas added to a height when the highest of several correlated samples represents them
ROOT_2PI = math.sqrt(2 * math.pi)


@kernel(nogil=True)
def ground_along(rays: Rays, density: Float64Array, fit: Float32Array, lifts: Float32Array) -> None:
    """Compute densities of an object on the ground; if it is slightly hidden, by the chance that the model errs."""
    heights, levels, ranges, knots, z0, bend, azimuth_density, slope_mean, slope_variance, height_variance, _ = rays
    for a in range(heights.shape[0]):
        top, top_k, before = -np.inf, 0, np.nan
        for k in range(heights.shape[1]):
            level = levels[a, k]
            if level == NO_LEVEL or heights[a, k] != heights[a, k]:
                before = np.nan  # unknown ground hides nothing and nothing is looked for there
                continue
            r = ranges[k]
            slope = (heights[a, k] - z0) / r - bend * r
            lift = max(top - slope, 0.0) * r
            if slope >= top:
                top, top_k = slope, k
            lifts[a, k] = lift
            low = slope if before != before else before
            before = slope
            if azimuth_density[a, knots[k]] <= 0:
                continue
            sigma = math.sqrt(slope_variance[a, knots[k]] + height_variance[level] / r**2)
            mean = slope_mean[a, knots[k]]
            value = mean_density((low - mean) / sigma, (slope - mean) / sigma)
            if lift > 0:
                crest = height_variance[levels[a, top_k]] * (r / ranges[top_k]) ** 2
                value *= math.erfc(lift / math.sqrt(2.0 * (height_variance[level] + crest) + 1e-6))
            density[a, k] = value / sigma
            fit[a, k] = value * ROOT_2PI


@kernel(nogil=True)
def smoke_along(rays: Rays, rise: float, found: SmokeDensities) -> None:
    """Compute densities of the marked slope with the base `seen` and `hidden`, without drift; `unseen`: the probability
    that the terrain hides the base. (A, R) each; `unseen` only where the mark is higher than `rise`, a slope."""
    heights, levels, ranges, knots, z0, bend, azimuth_density, slope_mean, slope_variance, height_variance, apart = rays
    seen, hidden, seen_fit, hidden_fit, unseen, lifts = found
    mu, var, knot = np.empty(CRESTS), np.empty(CRESTS), np.empty(CRESTS, np.int64)
    far, far_fit, at, left = np.empty(CRESTS), np.empty(CRESTS), np.empty(CRESTS), np.empty(CRESTS)
    sigmas, inverse = np.sqrt(height_variance), 1.0 / ranges
    all_far = all_fit = all_at = 0.0
    for a in range(heights.shape[0]):
        count, stale = np.int64(0), True
        top, surely = -np.inf, -np.inf  # of the crests: the highest, and what one of them surely reaches
        # Two stretches of samples that err alike with what is close behind them: this one and the one before.
        mu0, var0, score0, knot0, end0 = -np.inf, 0.0, -np.inf, np.int64(0), -np.inf
        mu1, var1, knot1 = -np.inf, 0.0, np.int64(0)
        before = np.nan
        for k in range(heights.shape[1]):
            level = levels[a, k]
            if level == NO_LEVEL or heights[a, k] != heights[a, k]:
                before = np.nan
                continue
            # The slope of this sample, and the stretch of samples that err alike with it; a finished one is a crest.
            r = ranges[k]
            slope = (heights[a, k] - z0) * inverse[k] - bend * r
            sigma = sigmas[level] * inverse[k]
            own = sigma * sigma
            # A camera stands where it sees over its foreground, whatever the terrain model has there.
            score = slope + _UPPER * sigma if r > FOREGROUND else slope - 1e6
            if r > end0:
                reach = _SURE * math.sqrt(var1)
                if mu1 > -np.inf and mu1 + reach >= top:
                    top, surely = max(top, mu1), max(surely, mu1 - reach)
                    count, stale = _add_crest(mu, var, knot, count, mu1, var1, knot1, top), True
                mu1, var1, knot1 = mu0, var0, knot0
                mu0, var0, score0, knot0, end0 = slope, own, score, knots[k], r + max(apart[level], _STRETCH * r)
            elif score > score0:
                mu0, var0, score0, knot0 = slope, own, score, knots[k]
            # The edge that hides the sample, and the chance that its foot is not seen.
            edge, edge_var, edge_knot = slope, own, knots[k]
            if mu0 > edge:
                edge, edge_var, edge_knot = mu0, var0, knot0
            if mu1 > edge:
                edge, edge_var, edge_knot = mu1, var1, knot1
            lift = (edge - slope) * r
            lifts[a, k] = max(lift, (top - slope) * r)
            covered = edge + 1.5 * _SURE * sigma < surely
            if covered:
                unseen[a, k] = 1.0
            elif slope_mean[a, knots[k]] - slope <= rise:
                pass
            elif k % _SPARSE != 0 and k > 0 and 0 < unseen[a, k - 1] < 1:
                unseen[a, k] = unseen[a, k - 1]
            else:
                # Twice the chance, so that a place that is just seen counts as seen: what is close errs alike.
                clear = 1.0 if lift <= 0 else 2.0 * higher(slope, own, edge, own)
                if clear > 0:
                    clear *= _all_lower(slope, own, mu, var, count, -1)
                unseen[a, k] = 1.0 - clear
            # Ground that is seen rises to the eye; an edge that falls is another one.
            low = edge if before != before else min(before, edge)
            before = edge
            if azimuth_density[a, knots[k]] <= 0:
                continue
            # What each crest far before gives, recomputed if a crest was added.
            if stale:
                all_far, all_fit, all_at = 0.0, 0.0, 0.0
                for i in range(count):
                    m, v = slope_mean[a, knot[i]], slope_variance[a, knot[i]]
                    far[i], far_fit[i], at[i], left[i] = _one(m, v, mu[i], mu[i], var[i])
                    if far[i] > 0:
                        others = _all_lower(at[i], left[i], mu, var, count, i)
                        far[i] *= others
                        far_fit[i] *= others
                    all_far, all_fit, all_at = all_far + far[i], all_fit + far_fit[i], all_at + far[i] * at[i]
                stale = False
            if covered:  # as most places behind a crest are: smoke comes up over the crests far before them
                hidden[a, k], hidden_fit[a, k] = all_far, all_fit
                if all_far > 0:
                    lifts[a, k] = max(all_at / all_far - slope, 0.0) * r
                continue
            # Smoke at the edge itself, and smoke that comes up over crests behind which the sample lies.
            m, v = slope_mean[a, edge_knot], slope_variance[a, edge_knot]
            near, near_fit = 0.0, 0.0
            if (low - m) * (edge - m) < 0 or min((low - m) ** 2, (edge - m) ** 2) < 49 * (v + edge_var):
                near, near_fit, where, spread = _one(m, v, low, edge, edge_var)
                if near > 0:
                    others = _all_lower(where, spread, mu, var, count, -1)
                    near *= others
                    near_fit *= others
            behind, behind_fit, raised = 0.0, 0.0, 0.0
            for i in range(count if all_far > 0 else 0):
                if far[i] > 0:
                    chance = higher(at[i], left[i], edge, edge_var)
                    behind += far[i] * chance
                    behind_fit += far_fit[i] * chance
                    raised += far[i] * chance * max(at[i] - slope, 0.0) * r
            # The sum, by whether the foot is seen.
            if lift > 0:
                hidden[a, k], hidden_fit[a, k] = near + behind, near_fit + behind_fit
                raised += near * lift
            else:
                seen[a, k], seen_fit[a, k] = near, near_fit
                hidden[a, k], hidden_fit[a, k] = behind, behind_fit
            if near + behind > 0:
                lifts[a, k] = raised / (near + behind)


@helper()
def _add_crest(
    mu: Float64Array,
    var: Float64Array,
    knot: Int64Array,
    count: int,
    new: float,
    new_var: float,
    new_knot: int,
    top: float,
) -> int:
    """Keep what may be higher than `top`: how many there are then."""
    kept = 0
    for i in range(count):
        if mu[i] + _SURE * math.sqrt(var[i]) >= top:
            mu[kept], var[kept], knot[kept] = mu[i], var[i], knot[i]
            kept += 1
    if kept < len(mu):
        mu[kept], var[kept], knot[kept] = new, new_var, new_knot
        return kept + 1
    least = 0
    for i in range(kept):
        if mu[i] + _UPPER * math.sqrt(var[i]) < mu[least] + _UPPER * math.sqrt(var[least]):
            least = i
    if new + _UPPER * math.sqrt(new_var) > mu[least] + _UPPER * math.sqrt(var[least]):
        mu[least], var[least], knot[least] = new, new_var, new_knot
    return kept


@helper()
def _one(mean: float, variance: float, low: float, edge: float, edge_var: float) -> tuple[float, float, float, float]:
    """Return the density of a marked slope where smoke comes up at an edge, that over its greatest, and the edge's
    slope as mark and terrain together have it, with variance. `low`: the edge one sample before."""
    total = variance + edge_var
    sigma = math.sqrt(total)
    value = mean_density((low - mean) / sigma, (edge - mean) / sigma)
    where = (mean * edge_var + edge * variance) / total
    return value / sigma, value * ROOT_2PI, where, edge_var * variance / total


@helper()
def _all_lower(slope: float, variance: float, mu: Float64Array, var: Float64Array, count: int, but: int) -> float:
    """Return the chance that all crests, `but` one, are lower than a slope."""
    chance = 1.0
    for j in range(count):
        if j != but:
            chance *= higher(slope, variance, mu[j], var[j])
            if chance == 0.0:
                break
    return chance


@helper()
def higher(a: float, a_var: float, b: float, b_var: float) -> float:
    """Return the probability that one normal variable is greater than another."""
    off, variance = a - b, a_var + b_var + 1e-14
    if off * off > _SURE * _SURE * variance:
        return 1.0 if off > 0 else 0.0
    return 0.5 * math.erfc(-off / math.sqrt(2.0 * variance))


@helper()
def mean_density(first: float, last: float) -> float:
    """Return the mean of the standard normal density between two values."""
    if min(abs(first), abs(last)) > 7 and first * last > 0:
        return 0.0
    if abs(last - first) > 0.3:
        return float((math.erf(last / math.sqrt(2.0)) - math.erf(first / math.sqrt(2.0))) / (2 * (last - first)))
    return float(math.exp(-0.125 * (first + last) ** 2) / ROOT_2PI)


@kernel(nogil=True)
def add_drifted(
    rays: Rays,
    widths: Float64Array,
    azimuth_density: Float64Array,
    lean: float,
    next_drift: Float64Array,
    found: SmokeDensities,
) -> None:
    """Convert densities of the slope to densities of the direction, in place. Smoke with a hidden base appears at the
    marked azimuths, wherever the base is: over these its slope's density is averaged, range by range.

    `widths`: (A,) of the fan. `azimuth_density`: (D, A, J) of the marked azimuth by drift. `lean`: sigma of the drift
    per metre of rise. `next_drift`: (D - 1,) start of the next drift."""
    heights, levels, ranges, knots, z0, bend, _, slope_mean, _, _, _ = rays
    azimuth_peak = np.empty((azimuth_density.shape[0], azimuth_density.shape[2]))
    for d in range(azimuth_density.shape[0]):
        for j in range(azimuth_density.shape[2]):
            azimuth_peak[d, j] = azimuth_density[d, :, j].max()
    density, hidden, fit, hidden_fit, unseen, lifts = found
    over, over_fit, marked = np.zeros(len(ranges)), np.zeros(len(ranges)), np.zeros(len(ranges))
    for a in range(heights.shape[0]):
        for k in range(heights.shape[1]):
            here = azimuth_density[0, a, knots[k]] * widths[a]
            if here > 0 and levels[a, k] != NO_LEVEL:
                over[k] += (density[a, k] + hidden[a, k]) * here
                over_fit[k] += (fit[a, k] + hidden_fit[a, k]) * here
                marked[k] += here
    drifts = azimuth_density.shape[0]
    for a in range(heights.shape[0]):
        for k in range(heights.shape[1]):
            if levels[a, k] == NO_LEVEL or heights[a, k] != heights[a, k]:
                continue
            knot = knots[k]
            here, peak = azimuth_density[0, a, knot], azimuth_peak[0, knot]
            seen, seen_fit = density[a, k] * here, fit[a, k] * here / peak
            behind, behind_fit = hidden[a, k] * here, hidden_fit[a, k] * here / peak
            r = ranges[k]
            above = slope_mean[a, knot] - ((heights[a, k] - z0) / r - bend * r)
            drift = lean * above
            if drifts > 1 and drift > next_drift[0] and marked[k] > 0 and unseen[a, k] > 0:
                number = 1
                while number < drifts - 1 and drift > next_drift[number]:
                    number += 1
                here, peak = azimuth_density[number, a, knot], azimuth_peak[number, knot]
                behind = here * unseen[a, k] * over[k] / marked[k]
                behind_fit = here / peak * unseen[a, k] * over_fit[k] / marked[k]
                if seen + behind > 0:
                    lifts[a, k] = behind / (seen + behind) * above * r
            density[a, k] = seen + behind
            fit[a, k] = seen_fit + behind_fit
