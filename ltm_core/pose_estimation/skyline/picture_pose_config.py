"""Define the constants of finding a pose in a photo, and how far vegetation raises a crest.

How far what grows on a crest stands over the DEM, by its label and how far away it is.

Labels of far crests are the more often wrong, so that heights by them draw together and spread."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from pydantic import Field

from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.vision.labels import Label

_NEAR, _FAR = 250.0, 1500.0
"""Ranges in metres; heights between them are interpolated by the logarithm of the range."""


class CoverHeights(StrictModel):
    """Mean height of each class on a crest above the DEM in metres, and its standard deviation."""

    tree: tuple[float, float]
    shrub: tuple[float, float]
    grass: tuple[float, float]
    bare: tuple[float, float]
    other: tuple[float, float]

    def table(self) -> Float64Array:
        """Return (256, 2) metres by label: height and sigma."""
        table = np.tile(np.array(self.other), (256, 1))
        for label, values in ((Label.TREE, self.tree), (Label.SHRUB, self.shrub), (Label.GRASS, self.grass)):
            table[label] = values
        table[[Label.BARE, Label.WATER]] = self.bare
        return table


class CrestCover(StrictModel):
    """Cover of crests up to 250 m and beyond 1500 m."""

    near: CoverHeights
    far: CoverHeights

    def of(self, labels: UInt8Array) -> Float64Array:
        """Return (N, 4) of labels (N,): near height and sigma, far height and sigma."""
        return np.asarray(_table(self)[labels], np.float64)

    def at(self, labels: UInt8Array, ranges: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return heights and sigmas (N,) of crests with these labels at these ranges (N,), metres."""
        both, far = self.of(labels), farness(ranges)
        height, sigma = ((1 - far) * both[:, k] + far * both[:, k + 2] for k in (0, 1))
        return height, sigma


@lru_cache(maxsize=8)
def _table(cover: CrestCover) -> Float64Array:
    """Return (256, 4) by label: a search asks for it hundreds of times."""
    return np.column_stack([cover.near.table(), cover.far.table()])


def farness(ranges: Float64Array) -> Float64Array:
    """Return 0 up to 250 m, 1 beyond 1500 m, and an interpolated value between."""
    return np.asarray(np.clip(np.log(np.maximum(ranges, 1.0) / _NEAR) / np.log(_FAR / _NEAR), 0.0, 1.0), np.float64)


def everywhere(heights: CoverHeights) -> CrestCover:
    """Return a cover with the same heights at all ranges."""
    return CrestCover(near=heights, far=heights)


BARE_EARTH = CrestCover(
    near=CoverHeights(tree=(5.5, 5.2), shrub=(0.7, 0.8), grass=(0.2, 0.4), bare=(0.1, 0.3), other=(1.0, 2.0)),
    far=CoverHeights(tree=(1.8, 2.9), shrub=(1.5, 2.0), grass=(0.3, 0.4), bare=(0.2, 0.4), other=(1.0, 2.0)),
)
"""Heights over a bare-earth DEM, estimated by maximum likelihood on `tower_k` to `tower_n` (192 rendered views with
true poses)."""
CANOPY_SURFACE = everywhere(
    CoverHeights(tree=(0.0, 1.0), shrub=(0.0, 0.5), grass=(0.1, 0.3), bare=(0.1, 0.3), other=(0.0, 1.0))
)
"""Heights for a DEM that already includes the canopy."""


class SkylineConfig(StrictModel):
    """Error model of a skyline against the terrain's horizon."""

    dem_sigma: float = Field(0.2, gt=0)
    """Standard deviation of the DEM's heights along a crest in metres."""
    cell_share: float = Field(0.08, ge=0)
    """Height by which the DEM cuts off crests, as a share of its cell size (standard deviation)."""
    cell_lift: float = Field(0.03, ge=0)
    """Mean height by which crests exceed the DEM, as a share of its cell size."""
    correlation: float = Field(60.0, gt=0)
    """Distance along a crest in metres within which the DEM's errors are fully correlated."""
    independent: float = Field(24.0, gt=0)
    """Maximum number of independent places of a skyline across the whole image, because it is smooth."""
    independent_fit: float = Field(40.0, gt=0)
    """Maximum number of independent places in the fit, which ignores outlier columns: errors of a sharp skyline vary
    faster."""
    stated: float = Field(2.0, gt=0)
    """Number of independent places by which the stated sigmas count against the misfit observed in the photo."""
    outliers: float = Field(0.15, gt=0, lt=1)
    """Share of columns whose skyline is something else: near trees, masts, clouds, wrong labels."""
    outlier_span: float = Field(0.2, gt=0)
    """Range in radians over which outliers are spread."""
    own_crest: float = Field(0.5, ge=0, lt=1)
    """Share of skylines that are the DEM's horizon where land beyond the DEM may rise above it."""
    cover: CrestCover = BARE_EARTH

    @property
    def odds(self) -> float:
        """Return the density ratio of a fitting column to an outlier for a sigma of one radian."""
        # 0.375: the density of Student's t with four degrees of freedom at 0
        return (1 - self.outliers) / self.outliers * self.outlier_span * 0.375


class ContourConfig(StrictModel):
    """Weights of ridges within the scene."""

    width: int = Field(640, gt=63)
    """Width in pixels of the images in which edges are searched."""
    coarse_width: int = Field(320, gt=31)
    """Width in pixels of the images in which poses are compared."""
    weight: float = Field(0.4, ge=0)
    """Weight of half the square of a pose's robust z-score among all compared poses."""
    most: float = Field(8.0, gt=0)
    """Maximum robust z-score that counts."""
    nearest: float = Field(150.0, ge=0)
    """Minimum range of ridges in metres; nearer ridges are trees as much as terrain."""
    sigma_px: float = Field(1.2, gt=0)
    """Standard deviation of an edge in pixels at width 640."""
    outliers: float = Field(0.5, gt=0, lt=1)
    correlation_px: float = Field(24.0, gt=0)
    """Length along a ridge in pixels at width 640 within which its errors are fully correlated."""
    correlation: float = Field(24.0, gt=0)
    """Length along a ridge in metres within which its errors are fully correlated; the longer of both counts."""
    most_points: int = Field(700, ge=1)
    """Maximum number of ridge points in a view by which a pose is refined."""

    def odds(self, search: float) -> float:
        """Return the ratio as `SkylineConfig.odds`, for a sigma of one pixel and edges within `search` pixels."""
        return (1 - self.outliers) / self.outliers * 0.75 * search


class SettlingConfig(StrictModel):
    """Correlation between neighbouring places of ridges (`ridge_settling`)."""

    least_plants: float = Field(0.3, ge=0, le=1)
    """Minimum share of trees and shrubs in the land for this step; nothing rises above the DEM on bare ground."""
    share: float = Field(0.6, ge=0, le=1)
    """Share of the variance of the cover on a ridge that plants of a stand have in common."""
    stand: float = Field(150.0, gt=0)
    """Correlation length in metres of the stand part."""
    plant: float = Field(5.0, gt=0)
    """Correlation length in metres of the remaining variance, the shape of single plants."""
    doubt: float = Field(2.0, gt=0)
    """Factor on the variance of a pose, because some edges belong to something else."""
    most_azimuth_sigma_deg: float = Field(0.3, gt=0)
    """Maximum standard deviation of the azimuth in degrees; less certain poses keep the solution of skyline and ridges.
    """
    most_points: int = Field(250, ge=1)
    """Maximum number of ridge points in a view; all are compared with each other."""


class SearchConfig(StrictModel):
    """Extent of the search for poses."""

    step_deg: float = Field(0.25, gt=0)
    wide_step_deg: float = Field(0.4, gt=0)
    """Step in degrees if no heading is known."""
    reach_sigmas: float = Field(4.0, gt=0)
    least_reach_deg: float = Field(12.0, gt=0)
    most_reach_deg: float = Field(40.0, gt=0)
    hypotheses: int = Field(8, ge=1)
    """Number of best poses that are refined, separated by `apart_deg`."""
    apart_deg: float = Field(1.2, gt=0)
    """Minimum separation in azimuth, in degrees, of the best poses that are refined."""
    extra_hypotheses: int = Field(6, ge=0)
    """Number of additional poses that are refined, separated by `extra_apart_deg`. Far ridges are periodic, with one
    local optimum per peak, and the best pose of the grid need not be the best after refinement."""
    extra_apart_deg: float = Field(0.5, gt=0)
    """Minimum separation of the additional poses in azimuth in degrees."""


class VerdictConfig(StrictModel):
    """Criteria for accepting a pose."""

    alternative_deg: float = Field(2.5, gt=0)
    """Minimum difference in azimuth in degrees between a pose and an alternative."""
    least_gap: float = 4.0
    """Minimum additional cost of an alternative; it is increased by `veil_factor`."""
    veil_factor: float = Field(5.0, ge=0)
    """Factor f in `least_gap` x (1 + f s), where s is the share of the skyline at which plants on a near crest may hide
    the horizon."""
    most_sigma_deg: float = Field(0.65, gt=0)
    """Maximum standard deviation of azimuth, pitch and roll in degrees."""
    close_azimuth_sigma_deg: float = Field(0.4, gt=0)
    """Maximum standard deviation of the azimuth in degrees if it rests on ridges alone, or if the view shows almost
    only plants, whose tops form the horizon."""
    mount_azimuth_sigma_deg: float = Field(0.3, gt=0)
    """Maximum standard deviation in degrees of the azimuth of a mount that many images determine jointly."""
    mount_apart_deg: float = Field(0.6, gt=0)
    """Maximum deviation in azimuth and pitch, in degrees, between the mount's pose and the poses of its images that are
    accepted individually: all in open views, otherwise those with all sigmas below `mount_sharp_deg`."""
    mount_sharp_deg: float = Field(0.1, gt=0)
    """Standard deviation in degrees below which the angles of a single image are sharp."""
    agreement: float = Field(1.0, gt=0)
    """Cost difference, in multiples of the variance of the skyline's misfits, by which a pose's weight falls to 1/e:
    small misfits separate poses better than stated, large ones less."""
    same_deg: float = Field(0.1, ge=0)
    """Difference in azimuth in degrees below which refined poses are the same."""
    least_support: float = Field(0.68, ge=0, le=1)
    """Minimum share of the skyline that fits."""
    sharp_support: float = Field(0.5, ge=0, le=1)
    """Minimum share of the skyline that fits if all sigmas are below `sharp_sigma_deg` or ridges alone agree; trees in
    front of a camera may hide half of a skyline."""
    sharp_sigma_deg: float = Field(0.35, gt=0)
    """Standard deviation in degrees below which `sharp_support` applies."""
    clear_support: float = Field(0.35, ge=0, le=1)
    """Minimum share of the skyline that fits for one of many images of a mount that decide jointly."""
    open_share: float = Field(0.25, ge=0, le=1)
    """Share of a skyline above which land beyond the DEM may rise. Beyond this share, a ridge that resembles the DEM's
    horizon may be another one, and the conditions `open_apart_deg` to `most_variance` apply."""
    open_apart_deg: float = Field(0.3, gt=0)
    """Maximum deviation in azimuth in degrees of the solution by ridges alone in an open view."""
    open_gap: float = 25.0
    """Minimum additional cost of an alternative in an open view."""
    open_azimuth_sigma_deg: float = Field(0.32, gt=0)
    """Maximum standard deviation of the azimuth in degrees in an open view."""
    most_variance: float = 2.2
    """Maximum variance of the misfits in an open view; other ridges have larger ones. It also applies if land beyond
    the DEM cannot be seen, unless all sigmas are below `sharp_sigma_deg`."""
    lone_score: float = 1.0
    """Score of the ridges, in sigmas of other poses, below which a pose rests on a single crest if also
    `lone_sigma_deg` applies; then ridges alone must agree."""
    lone_sigma_deg: float = Field(0.2, gt=0)
    """Standard deviation of the azimuth in degrees above which a pose with weak ridges rests on a single crest."""
    agree_chi_square: float = Field(7.8, gt=0)
    """Maximum chi-square of the three angles between the solutions by skyline and by ridges; 95 % of equal poses are
    below."""
    agree_cost: float = Field(2.5, gt=0)
    """Maximum additional cost that the skyline gives to the solution by ridges: one twelfth of the likelihood."""
    ridges_gap: float = 6.0
    """Minimum additional cost of an alternative if only ridges are known."""
    plants_gap: float = 8.0
    """Minimum additional cost of an alternative if only ridges are known and at least half of the land in the image is
    trees and shrubs, whose margins look like ridges."""
    plants_score: float = 6.0
    """Minimum score of the ridges, in multiples of chance, if at least half of the land is trees and shrubs."""
    ridges_variance: float = 1.4
    """Maximum variance of a skyline's misfits if only ridges are used; above it, the visible skyline contradicts them,
    mostly by terrain where the photo shows sky."""
    contradiction: float = Field(3.5, gt=0)
    """Maximum deviation from the prior pose in sigmas of an otherwise good pose. It is below
    `SearchConfig.reach_sigmas`, because alternatives beyond the edge of the search are unknown."""

    def support_asked(self, sigma_deg: float) -> float:
        """Return the minimum share of the skyline that must fit if the worst angle has the sigma `sigma_deg`."""
        return self.sharp_support if sigma_deg <= self.sharp_sigma_deg else self.least_support

    def gap_asked(self, veiled: float, variance: float) -> float:
        """Return the minimum additional cost of an alternative if plants may hide this share of the skyline. Misfits of
        a small `variance` separate poses better than stated; large ones do not reduce the cost."""
        return self.least_gap * min(variance, 1.0) * (1 + self.veil_factor * veiled)


FLOOR_DEG = (0.01, 0.012, 0.01)
"""Minimum standard deviation of azimuth, pitch and roll in degrees, from errors of refraction and datum."""
MOUNT_FLOOR_DEG = (0.03, 0.015, 0.05)
"""Minimum standard deviation of a mount in degrees, which includes errors of the lens. The value for pitch is for one
direction; with n directions it is divided by the root of n, because the skyline's place in the image differs between
them."""


class PicturePoseConfig(StrictModel):
    """All constants of pose estimation from a photo."""

    skyline: SkylineConfig = SkylineConfig()
    contours: ContourConfig = ContourConfig()
    settling: SettlingConfig = SettlingConfig()
    search: SearchConfig = SearchConfig()
    verdict: VerdictConfig = VerdictConfig()
    working_width: int = Field(1280, gt=63)
    """Working width in pixels; wider photos are reduced to it."""
