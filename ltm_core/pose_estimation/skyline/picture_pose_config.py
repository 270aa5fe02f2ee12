"""Define the constants of finding a pose in a photo, and how far vegetation raises a crest.

Labels of far crests are more often wrong, so that heights by them draw together and spread."""

from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.vision.labels import Label

_NEAR, _FAR = 250.0, 1500.0  # ranges in metres; heights between them are interpolated by the logarithm of the range
_Height = tuple[float, float]


def crest_heights(tree: _Height, shrub: _Height, grass: _Height, bare: _Height, other: _Height) -> Float64Array:
    """Return (256, 2) by label: mean height of what grows on a crest above the DEM and its sigma, metres."""
    table = np.tile(np.array(other), (256, 1))
    table[[Label.TREE, Label.SHRUB, Label.GRASS, Label.BARE, Label.WATER]] = tree, shrub, grass, bare, bare
    return table


@dataclass(frozen=True, eq=False)
class CrestCover:
    """Cover of crests, each as `crest_heights`: up to 250 m (`near`) and beyond 1500 m."""

    near: Float64Array
    far: Float64Array

    def at(self, labels: UInt8Array, ranges: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return heights and sigmas (N,) of crests with these labels at these ranges (N,), metres."""
        far = farness(ranges)[:, None]
        height, sigma = ((1 - far) * self.near[labels] + far * self.far[labels]).T
        return height, sigma


def farness(ranges: Float64Array) -> Float64Array:
    """Return 0 up to 250 m, 1 beyond 1500 m, and an interpolated value between."""
    return np.asarray(np.clip(np.log(np.maximum(ranges, 1.0) / _NEAR) / np.log(_FAR / _NEAR), 0.0, 1.0), np.float64)


BARE_EARTH = CrestCover(
    near=crest_heights(tree=(5.5, 5.2), shrub=(0.7, 0.8), grass=(0.2, 0.4), bare=(0.1, 0.3), other=(1.0, 2.0)),
    far=crest_heights(tree=(1.8, 2.9), shrub=(1.5, 2.0), grass=(0.3, 0.4), bare=(0.2, 0.4), other=(1.0, 2.0)),
)
"""Over a bare-earth DEM, by maximum likelihood on 192 rendered views of `tower_k` to `tower_n` with true poses."""
_CANOPY = crest_heights(tree=(0.0, 1.0), shrub=(0.0, 0.5), grass=(0.1, 0.3), bare=(0.1, 0.3), other=(0.0, 1.0))
CANOPY_SURFACE = CrestCover(_CANOPY, _CANOPY)  # for a DEM that already includes the canopy


class SkylineErrors:
    """Error model of a skyline against the terrain's horizon."""

    dem_sigma = 0.2  # standard deviation of the DEM's heights along a crest, m
    cell_share = 0.08  # height by which the DEM cuts off crests, as a share of its cells (standard deviation)
    cell_lift = 0.03  # mean height by which crests exceed the DEM, as a share of its cells
    correlation = 60.0  # distance along a crest within which the DEM's errors are fully correlated, m
    independent = 24.0  # maximum number of independent places of a skyline, because it is smooth
    independent_fit = 40.0  # the same in the fit: errors of a sharp skyline without outliers vary faster
    stated = 2.0  # number of independent places by which the stated sigmas count against the observed misfit
    outliers = 0.15  # share of columns that show something else: near trees, masts, clouds, wrong labels
    outlier_span = 0.2  # range over which outliers are spread, rad
    own_crest = 0.5  # share of skylines that are the DEM's horizon where land beyond the DEM may rise above it
    odds = (1 - outliers) / outliers * outlier_span * 0.375
    """Density ratio of a fitting column to an outlier for a sigma of one radian. 0.375: the density of Student's t with
    four degrees of freedom at 0."""


class Criteria:
    """Criteria for accepting a pose.

    A gap is the additional cost of the best alternative, which differs by `alternative_deg` or more in azimuth. In an
    open view land beyond the DEM may rise above more than `open_share` of the skyline: a ridge that resembles the DEM's
    horizon may be another one, and `open_apart_deg` to `most_variance` apply. The pose rests on a single crest if its
    ridges score less than `lone_score` and its azimuth is less sure than `lone_sigma_deg`; ridges alone must then
    agree, as they must in open views. "Planted" is land with at least half trees and shrubs, whose margins look like
    ridges."""

    alternative_deg = 2.5
    least_gap = 4.0  # minimum gap, times 1 + `veil_factor` x the share of the skyline that plants may hide
    veil_factor = 5.0
    most_sigma_deg = 0.65  # maximum sigma of azimuth, pitch and roll
    close_azimuth_sigma_deg = 0.4  # of an azimuth by ridges alone, or in a view of almost only plants
    mount_azimuth_sigma_deg = 0.3  # of the azimuth of a mount that many images determine jointly
    mount_apart_deg = 0.6  # maximum angle between a mount's pose and those of its images accepted individually
    mount_sharp_deg = 0.1  # maximum sigma of these images, except in open views, where all count
    agreement = 1.0  # cost, in variances of the skyline's misfits, by which a pose's weight falls to 1/e
    same_deg = 0.1  # azimuth within which refined poses are the same
    least_support = 0.68  # minimum share of the skyline that fits
    sharp_support = 0.5  # the same for sure angles or if ridges agree; near trees may hide half of a skyline
    sharp_sigma_deg = 0.35  # maximum sigma of sure angles
    clear_support = 0.35  # minimum share of the skyline for one of many images of a mount that decide jointly
    open_share = 0.25
    open_apart_deg = 0.3  # maximum azimuth from the solution by ridges alone
    open_gap = 25.0  # gap from which ridges are not asked
    open_azimuth_sigma_deg = 0.32
    most_variance = 2.2  # maximum variance of the misfits; without an open view, of poses that are not sure
    lone_score = 1.0
    lone_sigma_deg = 0.2
    agree_chi_square = 7.8  # of the angles between skyline and ridges; 95 % of equal poses are below
    agree_cost = 2.5  # maximum cost that the skyline adds to the solution by ridges: 1/12 of the likelihood
    ridges_gap = 6.0  # minimum gap if only ridges are known
    plants_gap = 8.0  # minimum gap if only ridges are known, in planted land
    plants_score = 6.0  # minimum score of the ridges there, in multiples of chance
    ridges_variance = 1.4  # maximum variance of a visible skyline's misfits if only ridges are used
    contradiction = 3.5
    """Maximum deviation from the prior pose in sigmas of an otherwise good pose. It is below that of the search
    (`search_reach`), because alternatives beyond its edge are unknown."""

    @classmethod
    def gap_asked(cls, veiled: float, variance: float) -> float:
        """Return the minimum gap if plants may hide this share of the skyline. Misfits of a small `variance` separate
        poses better than stated; large ones do not reduce the cost."""
        return cls.least_gap * min(variance, 1.0) * (1 + cls.veil_factor * veiled)


FLOOR_DEG = (0.01, 0.012, 0.01)  # minimum sigma of azimuth, pitch and roll, by errors of refraction and datum
MOUNT_FLOOR_DEG = (0.03, 0.015, 0.05)
"""Minimum standard deviation of a mount in degrees, which includes errors of the lens. The value for pitch is for one
direction; with n directions, whose skylines lie elsewhere in the image, it is divided by the root of n."""
