"""Whether a pose that was found in a picture is to be taken, by how it stands out from all others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.pose_hypothesis import Hypothesis
from ltm_core.pose_estimation.pose_prior import PosePrior, angles_between

MANY_PLANTS = 0.5
"""Share of trees and shrubs in the land from which on edges are theirs as well as the ground's,"""
OVERGROWN = 0.85
"""and from which on hardly anything else is in the picture."""
Word = Literal["accepted", "ambiguous", "no_skyline", "contradicts_prior"]


@dataclass(frozen=True)
class Verdict:
    """`word`, and why in words. `gap`: by how much the best alternative costs more (inf: there is none);
    `alternative_deg`: its azimuth; `sigma_deg`: of azimuth, pitch, roll; `support`: share of the skyline that fits.
    """

    word: Word
    reason: str
    gap: float
    alternative_deg: float | None
    sigma_deg: tuple[float, float, float]
    support: float


def judge(
    hypotheses: Sequence[Hypothesis],
    by_ridges: bool,
    prior: PosePrior,
    config: PicturePoseConfig,
    plants: float,
    gap_by_ridges: float | None = None,
) -> Verdict:
    """Judge the first of `hypotheses`, from the best down; `by_ridges`: they were found without a skyline. `plants`:
    the share of trees and shrubs in the picture's land. `gap_by_ridges`: ridges alone are of the same pose, and
    alternatives cost so much more by them.
    """
    v = config.verdict
    nowhere = (math.inf, math.inf, math.inf)
    if not hypotheses:
        return Verdict(
            "no_skyline", "neither a skyline nor a ridge of the DEM is in the picture", 0.0, None, nowhere, 0.0
        )
    best = hypotheses[0]
    sigma = azimuth, pitch, roll = best.refined.sigma_deg
    gap, other = math.inf, None
    middle = best.about or best.refined.pose  # what is not part of a mean is an alternative to it
    for hypothesis in hypotheses[1:]:
        away = abs(float(angles_between(middle, hypothesis.refined.pose)[0]))
        if away > math.radians(v.alternative_deg):
            gap, other = hypothesis.cost - best.cost + (gap_by_ridges or 0.0), hypothesis.refined.pose.angles_deg[0]
            break
    support = best.refined.skyline.support

    def verdict(word: Word, reason: str) -> Verdict:
        return Verdict(word, reason, gap, other, sigma, support)

    close = by_ridges or (plants >= OVERGROWN and gap_by_ridges is None)
    most_azimuth = v.close_azimuth_sigma_deg if close else v.most_sigma_deg
    open_view = best.refined.skyline.open > v.open_share
    if open_view:
        most_azimuth = min(most_azimuth, v.open_azimuth_sigma_deg)
    if max(sigma) > v.most_sigma_deg or azimuth > most_azimuth:
        known = "what ridges are in the picture" if by_ridges else "the skyline"
        word: Word = "no_skyline" if by_ridges else "ambiguous"
        return verdict(word, f"{known} leaves azimuth, pitch, roll open by {azimuth:.2f}, {pitch:.2f}, {roll:.2f} deg")
    veiled, variance = best.refined.skyline.veiled, best.refined.skyline.variance
    least = v.gap_asked(veiled, variance)
    if by_ridges:
        least = v.plants_gap if plants >= MANY_PLANTS else v.ridges_gap
        if plants >= MANY_PLANTS and best.ridge_score < v.plants_score:
            return verdict("ambiguous", f"ridges lie on edges only {best.ridge_score:.1f} times more than by chance")
        if variance > v.ridges_variance:
            return verdict(
                "ambiguous", f"the photo's skyline speaks against it: its misfits' variance is {variance:.1f}"
            )
    elif variance > v.most_variance and (open_view or max(sigma) > v.sharp_sigma_deg):
        doubt = "may be of land beyond the DEM" if open_view else "leaves an angle unsure"
        return verdict("ambiguous", f"the skyline {doubt}, and its misfits' variance on the horizon is {variance:.1f}")
    if gap < least:
        hidden = f", and plants on near crests may hide {veiled:.0%} of the horizon"
        told = hidden if veiled > 0.03 and not by_ridges else ""
        return verdict("ambiguous", f"azimuth {other:.1f} deg costs only {gap:.1f} more{told}")
    asked = v.least_support if open_view else v.support_asked(max(sigma))
    if not by_ridges and support < (asked if gap_by_ridges is None else v.sharp_support):
        return verdict("ambiguous", f"only {support:.0%} of the photo's skyline lies on the terrain's")
    away_by = np.abs(prior.deviation(best.refined.pose)[3:]) / prior.sigmas[3:]
    if away_by.max() > v.contradiction:
        name = ("azimuth", "pitch", "roll")[int(away_by.argmax())]
        return verdict("contradicts_prior", f"the picture's {name} is {away_by.max():.1f} sigmas from the stated one")
    return verdict(
        "accepted", f"the next best azimuth costs {gap:.1f} more" if math.isfinite(gap) else "no alternative"
    )
