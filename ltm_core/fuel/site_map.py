"""Makes the empty evidence map of a site, with its prior and label errors, from the site file."""

from __future__ import annotations

from collections.abc import Callable

from ltm_core.fuel.codes import FuelRegion
from ltm_core.fuel.prior_io import load_prior, prior_heights
from ltm_core.fuel.site_label_errors import camera_label_errors, site_label_errors
from ltm_core.fuel.surface_change import LivingFuelMap
from ltm_core.grid import GridGeometry
from ltm_core.site import Site
from ltm_core.types import Float32Array
from ltm_core.vision.labels import LabelSet


def site_evidence_map(site: Site, geometry: GridGeometry, labels: LabelSet) -> LivingFuelMap:
    """An empty map on the fuel grid (`Site.fuel_geometry`, in the map frame) over the site's prior.

    Raises ConfigError and RasterError for a region, label errors or prior that cannot be taken.
    """
    return empty_maps(site, geometry, labels)()


def empty_maps(site: Site, geometry: GridGeometry, labels: LabelSet) -> Callable[[], LivingFuelMap]:
    """Makes such maps, as many as are asked for, of files that are read once, now. Raises as `site_evidence_map`."""
    fuel = site.fuel
    prior = None if fuel.prior is None else load_prior(fuel.prior, site.in_crs(geometry))
    region = FuelRegion.named(fuel.region)
    errors, of_cameras = site_label_errors(site), camera_label_errors(site)
    return lambda: LivingFuelMap(geometry, prior, labels, fuel.fusion, errors, region, of_cameras)


def spare_heights(site: Site, geometry: GridGeometry) -> Float32Array | None:
    """The elevations that came with the prior on the fuel grid (in the map frame); None: it has none."""
    return None if site.fuel.prior is None else prior_heights(site.fuel.prior, site.in_crs(geometry))
