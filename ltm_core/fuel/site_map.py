"""Makes the empty evidence map of a site, with its prior and label errors, from the site file."""

from __future__ import annotations

from pathlib import Path

from ltm_core.fuel.codes import FuelRegion
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.prior_io import load_prior, prior_heights
from ltm_core.fuel.surface_change import LivingFuelMap
from ltm_core.grid import GridGeometry
from ltm_core.site import Site
from ltm_core.types import Float32Array
from ltm_core.vision.labels import LabelSet


def site_evidence_map(site: Site, geometry: GridGeometry, labels: LabelSet) -> LivingFuelMap:
    """An empty map on the fuel grid (`Site.fuel_geometry`, in the map frame) over the site's prior.

    Raises ConfigError and RasterError for a region, label errors or prior that cannot be taken.
    """
    fuel = site.fuel
    prior = None if fuel.prior is None else load_prior(fuel.prior, site.in_crs(geometry))
    return LivingFuelMap(geometry, prior, labels, fuel.fusion, site_label_errors(site), FuelRegion.named(fuel.region))


def site_label_errors(site: Site) -> LabelErrors:
    """What is known of the errors of the site's network. Raises ConfigError."""
    given = site.fuel.label_errors
    return LabelErrors.of_model(site.model) if given is None else LabelErrors.load(Path(given))


def spare_heights(site: Site, geometry: GridGeometry) -> Float32Array | None:
    """The elevations that came with the prior on the fuel grid (in the map frame); None: it has none."""
    return None if site.fuel.prior is None else prior_heights(site.fuel.prior, site.in_crs(geometry))
