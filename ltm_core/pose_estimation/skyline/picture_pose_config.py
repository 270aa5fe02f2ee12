"""Define the constants of finding a pose in a photo, and how far vegetation raises a crest.

How far what grows on a crest stands over the DEM, by its label and how far away it is.

Labels of far crests are the more often wrong, so that heights by them draw together and spread.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from pydantic import Field

from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.vision.labels import Label

_NEAR, _FAR = 250.0, 1500.0
"""Metres; between them by the logarithm of the range."""


class CoverHeights(StrictModel):
    """Metres by which a crest of each class stands over the DEM, and their standard deviation."""

    tree: tuple[float, float]
    shrub: tuple[float, float]
    grass: tuple[float, float]
    bare: tuple[float, float]
    other: tuple[float, float]

    def table(self) -> Float64Array:
        """(256, 2) metres by label: how high, and its sigma."""
        table = np.tile(np.array(self.other), (256, 1))
        for label, values in ((Label.TREE, self.tree), (Label.SHRUB, self.shrub), (Label.GRASS, self.grass)):
            table[label] = values
        table[[Label.BARE, Label.WATER]] = self.bare
        return table


class CrestCover(StrictModel):
    """Of crests up to 250 m away, and from 1500 m on."""

    near: CoverHeights
    far: CoverHeights

    def of(self, labels: UInt8Array) -> Float64Array:
        """(N, 4) of labels (N,): near height and sigma, far height and sigma."""
        return np.asarray(_table(self)[labels], np.float64)

    def at(self, labels: UInt8Array, ranges: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Heights and sigmas (N,) of crests with these labels at these ranges (N,), metres."""
        both, far = self.of(labels), farness(ranges)
        height, sigma = ((1 - far) * both[:, k] + far * both[:, k + 2] for k in (0, 1))
        return height, sigma


@lru_cache(maxsize=8)
def _table(cover: CrestCover) -> Float64Array:
    """(256, 4) by label: a search asks for it hundreds of times."""
    return np.column_stack([cover.near.table(), cover.far.table()])


def farness(ranges: Float64Array) -> Float64Array:
    """0 up to 250 m, 1 from 1500 m on."""
    return np.asarray(np.clip(np.log(np.maximum(ranges, 1.0) / _NEAR) / np.log(_FAR / _NEAR), 0.0, 1.0), np.float64)


def everywhere(heights: CoverHeights) -> CrestCover:
    """The same at all ranges."""
    return CrestCover(near=heights, far=heights)


BARE_EARTH = CrestCover(
    near=CoverHeights(tree=(5.5, 5.2), shrub=(0.7, 0.8), grass=(0.2, 0.4), bare=(0.1, 0.3), other=(1.0, 2.0)),
    far=CoverHeights(tree=(1.8, 2.9), shrub=(1.5, 2.0), grass=(0.3, 0.4), bare=(0.2, 0.4), other=(1.0, 2.0)),
)
"""Over a DEM of bare earth; by maximum likelihood on `tower_k` to `tower_n`, 192 rendered views, true poses."""
CANOPY_SURFACE = everywhere(
    CoverHeights(tree=(0.0, 1.0), shrub=(0.0, 0.5), grass=(0.1, 0.3), bare=(0.1, 0.3), other=(0.0, 1.0))
)
"""For a DEM that holds the tops of the canopy already."""


class SkylineConfig(StrictModel):
    """How far a skyline may lie from the terrain's horizon."""

    dem_sigma: float = Field(0.2, gt=0)
    """Metres, of the DEM's heights along a crest,"""
    cell_share: float = Field(0.08, ge=0)
    """and of its cell, that crests are cut into,"""
    cell_lift: float = Field(0.03, ge=0)
    """which they stand over by this."""
    correlation: float = Field(60.0, gt=0)
    """Metres along a crest within which these errors are one and the same,"""
    independent: float = Field(24.0, gt=0)
    """and how many independent places a skyline has at most that goes all through a picture: it is smooth;"""
    independent_fit: float = Field(40.0, gt=0)
    """in the fit, to which columns of something else do not count, so many: errors of a sharp one change faster."""
    stated: float = Field(2.0, gt=0)
    """Independent places as which these sigmas count beside those where a photo shows how far its skyline lies off."""
    outliers: float = Field(0.15, gt=0, lt=1)
    """Share of columns whose skyline is something else: near trees, masts, clouds, wrong labels."""
    outlier_span: float = Field(0.2, gt=0)
    """Radians over which those are spread."""
    own_crest: float = Field(0.5, ge=0, lt=1)
    """Share of skylines that are the DEM's horizon where land beyond it may stand over that."""
    no_land: float = Field(0.2, gt=0, lt=1)
    """Share of pale edges above a crest that are no land's."""
    cover: CrestCover = BARE_EARTH

    @property
    def odds(self) -> float:
        """The density of a fitting column in one sigma over that of an outlier, for a sigma of one radian."""
        # 0.375: the density of Student's t with four degrees of freedom at 0
        return (1 - self.outliers) / self.outliers * self.outlier_span * 0.375


class ContourConfig(StrictModel):
    """What ridges within the scene count."""

    width: int = Field(640, gt=63)
    """Pixels across the pictures in which edges are sought,"""
    coarse_width: int = Field(320, gt=31)
    """and in which poses are compared."""
    weight: float = Field(0.4, ge=0)
    """Of half the square of a pose's robust z among all that were compared,"""
    most: float = Field(8.0, gt=0)
    """which counts up to here."""
    nearest: float = Field(150.0, ge=0)
    """Metres: nearer ridges are trees as much as terrain."""
    sigma_px: float = Field(1.2, gt=0)
    """Of an edge at width 640."""
    outliers: float = Field(0.5, gt=0, lt=1)
    correlation_px: float = Field(24.0, gt=0)
    """Pixels at width 640 along a ridge within which its errors are one and the same,"""
    correlation: float = Field(24.0, gt=0)
    """and metres, whichever is longer."""
    most_points: int = Field(700, ge=1)
    """Of the ridges in a view, by which a pose is refined."""

    def odds(self, search: float) -> float:
        """As `SkylineConfig.odds`, for a sigma of one pixel and edges within `search` pixels."""
        return (1 - self.outliers) / self.outliers * 0.75 * search


class SettlingConfig(StrictModel):
    """What neighbouring places of ridges have in common (`ridge_settling`)."""

    least_plants: float = Field(0.3, ge=0, le=1)
    """Share of trees and shrubs in the land from which on poses settle: of bare ground nothing stands over the DEM."""
    share: float = Field(0.6, ge=0, le=1)
    """Of the variance of what grows on a ridge, that which stands of plants have in common,"""
    stand: float = Field(150.0, gt=0)
    """over so many metres,"""
    plant: float = Field(5.0, gt=0)
    """and over how many the rest goes on, the shape of single plants."""
    doubt: float = Field(2.0, gt=0)
    """By which the variance of a pose is larger than these say: some edges are of something else."""
    most_azimuth_sigma_deg: float = Field(0.3, gt=0)
    """A pose that is less sure by its ridges stays where skyline and ridges have put it."""
    most_points: int = Field(250, ge=1)
    """Of the ridges in a view: all are compared with each other."""


class SearchConfig(StrictModel):
    """Where poses are sought."""

    step_deg: float = Field(0.25, gt=0)
    wide_step_deg: float = Field(0.4, gt=0)
    """Where no heading is known."""
    reach_sigmas: float = Field(4.0, gt=0)
    least_reach_deg: float = Field(12.0, gt=0)
    most_reach_deg: float = Field(40.0, gt=0)
    hypotheses: int = Field(8, ge=1)
    """Poses that are refined, the best of those that are"""
    apart_deg: float = Field(1.2, gt=0)
    """from each other in azimuth,"""
    teeth: int = Field(6, ge=0)
    """and so many more that are"""
    teeth_apart_deg: float = Field(0.5, gt=0)
    """from those. Far ranges are like saws: a best fit a tooth, and the best of the grid need not be that of the
    refined."""


class VerdictConfig(StrictModel):
    """When a pose is accepted."""

    alternative_deg: float = Field(2.5, gt=0)
    """An alternative is a pose that differs by more in azimuth."""
    least_gap: float = 4.0
    """By which its cost must be higher,"""
    veil_factor: float = Field(5.0, ge=0)
    """times one more than this times the share of the skyline where plants on a near crest may hide the horizon."""
    most_sigma_deg: float = Field(0.65, gt=0)
    """Of azimuth, pitch and roll,"""
    close_azimuth_sigma_deg: float = Field(0.4, gt=0)
    """and of an azimuth by ridges alone, or where nearly all that is seen are plants: their tops are the horizon."""
    mount_azimuth_sigma_deg: float = Field(0.3, gt=0)
    """Of the azimuth of a mount that many pictures decide together,"""
    mount_apart_deg: float = Field(0.6, gt=0)
    """and within which of azimuth and pitch it puts those of them that are accepted by themselves: in open views all,
    else those whose angles are all as sure as"""
    mount_sharp_deg: float = Field(0.1, gt=0)
    """this."""
    agreement: float = Field(1.0, gt=0)
    """By how much more the cost of a pose must be for its weight among those about the best to fall to 1/e, times the
    variance of the skyline's misfits: small ones tell poses apart by more than is stated, large ones by less."""
    same_deg: float = Field(0.1, ge=0)
    """Of azimuth, between refined poses that are one."""
    least_support: float = Field(0.68, ge=0, le=1)
    """Share of the skyline that fits,"""
    sharp_support: float = Field(0.5, ge=0, le=1)
    """and that where it makes all angles as sure as"""
    sharp_sigma_deg: float = Field(0.35, gt=0)
    """this, or where ridges alone agree: trees before a camera hide half of a skyline, and the other half may do."""
    clear_support: float = Field(0.35, ge=0, le=1)
    """The same for one of many pictures of a mount that decide together: from here on it shows a skyline at all."""
    open_share: float = Field(0.25, ge=0, le=1)
    """Share of a skyline over which land beyond the DEM may stand: beyond it, what lies on the DEM's horizon may be a
    range that looks like it. Then ridges alone must agree"""
    open_apart_deg: float = Field(0.3, gt=0)
    """within so much of azimuth,"""
    open_gap: float = 25.0
    """or an alternative must cost so much more,"""
    open_azimuth_sigma_deg: float = Field(0.32, gt=0)
    """and the azimuth be as sure as this,"""
    most_variance: float = 2.2
    """and the variance of the misfits no larger: another range's is. So, too, where land beyond the DEM cannot be seen,
    unless all angles are as sure as `sharp_sigma_deg`."""
    lone_score: float = 1.0
    """Where ridges lie on edges less than this, in sigmas of what other poses have,"""
    lone_sigma_deg: float = Field(0.2, gt=0)
    """and the azimuth is less sure than this, a crest is all that a pose is by: ridges alone must agree, as where the
    skyline by itself leaves it open,"""
    agree_chi_square: float = Field(7.8, gt=0)
    """to such a chi-square of the three angles they differ by, 95 % of those of one pose,"""
    agree_cost: float = Field(2.5, gt=0)
    """and what is between them may cost a skyline of the DEM so much more than its own pose: a twelfth as likely."""
    ridges_gap: float = 6.0
    """`least_gap` where ridges alone are known,"""
    plants_gap: float = 8.0
    """and where trees and shrubs are half of the land in the picture or more, whose margins look like ridges;"""
    plants_score: float = 6.0
    """then ridges must also lie on edges so many times more than chance."""
    ridges_variance: float = 1.4
    """Of a skyline's misfits where ridges are taken alone: beyond it what skyline there is speaks against them, most
    often by terrain where the photo has sky."""
    contradiction: float = Field(3.5, gt=0)
    """Sigmas by which an otherwise good pose may differ from the prior one: fewer than `SearchConfig.reach_sigmas`, for
    of a pose at the search's edge the alternatives beyond it are not known."""

    def support_asked(self, sigma_deg: float) -> float:
        """The share of the skyline that must fit where the least sure of the angles is known to `sigma_deg`."""
        return self.sharp_support if sigma_deg <= self.sharp_sigma_deg else self.least_support

    def gap_asked(self, veiled: float, variance: float) -> float:
        """By how much an alternative must cost more, where plants may hide such a share of the skyline. Misfits of a
        small `variance` tell poses apart by more than is stated; large ones make no pose unlikelier than its cost."""
        return self.least_gap * min(variance, 1.0) * (1 + self.veil_factor * veiled)


FLOOR_DEG = (0.01, 0.012, 0.01)
"""Of azimuth, pitch and roll: what errors of refraction and datum leave, however sharp the skyline,"""
MOUNT_FLOOR_DEG = (0.03, 0.015, 0.05)
"""and for what holds in all directions: what those of a lens leave, too. Of pitch in one direction, and in several by
the root of how many less: where in the picture a skyline lies differs between them."""


class PicturePoseConfig(StrictModel):
    """All of it."""

    skyline: SkylineConfig = SkylineConfig()
    contours: ContourConfig = ContourConfig()
    settling: SettlingConfig = SettlingConfig()
    search: SearchConfig = SearchConfig()
    verdict: VerdictConfig = VerdictConfig()
    working_width: int = Field(1280, gt=63)
    """Pixels: wider photos are looked at in this width."""
