"""Make the evidence map of a site's fuels, and the canopy that its cameras have measured."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ltm_core.base.errors import ConfigError, RasterError, StoreError
from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_core.fuel.canopy import SeenCanopy, measured_canopy, seen_canopy, stand_heights
from ltm_core.fuel.codes import FuelClimate, FuelSystem
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.export.landscape import Landscape, canopy_bands
from ltm_core.fuel.export.provenance import (
    NOTHING_SEEN,
    WITHOUT_DATES,
    Provenance,
    iso_moment,
    landfire_version,
    software,
    surface_note,
)
from ltm_core.fuel.label_errors import UNMEASURED, LabelErrors
from ltm_core.fuel.life_form import NODATA, LifeForm, forms_of, label_forms
from ltm_core.fuel.prior import FuelPrior
from ltm_core.fuel.prior_io import load_prior, prior_heights
from ltm_core.fuel.surface_change import LivingFuelMap
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_surface import STORE_FILE, open_stored_surface
from ltm_core.site.networks import camera_label_errors, labels_state, site_label_errors
from ltm_core.site.site import Site
from ltm_core.surface.confirmed_surface import SurfaceVersion
from ltm_core.surface.surface_versions_io import ConfirmedTerrain
from ltm_core.vision.labels import LabelSet


def site_evidence_map(site: Site, geometry: GridGeometry, labels: LabelSet) -> LivingFuelMap:
    """Return an empty map on the fuel grid (`Site.fuel_geometry`, in the map frame) over the site's prior.

    Raises ConfigError and RasterError for a climate, label errors or prior that cannot be taken."""
    return empty_maps(site, geometry, labels)()


def empty_maps(
    site: Site, geometry: GridGeometry, labels: LabelSet, given: LabelErrors | None = None
) -> Callable[[], LivingFuelMap]:
    """Return a function that makes such maps from files that are read once, now; `given`: label errors instead of the
    known ones. Raises as `site_evidence_map`."""
    fuel = site.fuel
    prior = None if fuel.prior is None else load_prior(fuel.prior, site.in_crs(geometry))
    climate = FuelClimate.named(fuel.climate)
    known = (site_label_errors(site), camera_label_errors(site)) if given is None else (given, {})
    errors, of_cameras = known
    return lambda: LivingFuelMap(geometry, prior, labels, fuel.fusion, errors, climate, of_cameras)


def measured_errors(
    site: Site,
    geometry: GridGeometry,
    labels: LabelSet,
    votes: Sequence[CellVotes],
    source: str,
    reference: tuple[LabelErrors, Sequence[CellVotes]] | None = None,
) -> LabelErrors:
    """Return the label errors of a network by its votes and the site's prior map (`measure_labels`).

    `reference`: another network's errors and its votes for the same frames. Raises ConfigError without a prior map, and
    as `measure_labels` and `site_evidence_map`."""
    from ltm_core.fuel.label_measurement import measure_labels

    prior = empty_maps(site, geometry, labels, UNMEASURED)().prior
    if prior is None:
        raise ConfigError(f"site {site.name} has no prior map (fuel.prior); labels are measured against one")

    def changes(errors: LabelErrors, of: Sequence[CellVotes] = votes) -> UInt8Array:
        evidence = empty_maps(site, geometry, labels, errors)()
        for frame in of:
            evidence.add(frame)
        layers = evidence.layers()
        return np.where(layers.changed, layers.life_form, 0).astype(np.uint8)

    known = None if reference is None else changes(*reference)
    reach = site.fuel.fusion.context_cells
    return measure_labels(votes, prior.codes, label_forms(labels), reach, changes, known, source)


def spare_heights(site: Site, geometry: GridGeometry) -> Float32Array | None:
    """Return the elevations of the prior on the fuel grid (in the map frame); None: it has none."""
    return None if site.fuel.prior is None else prior_heights(site.fuel.prior, site.in_crs(geometry))


@dataclass(frozen=True, eq=False)
class SiteCanopy:
    """Canopy of a site. `note`: remark for the user; empty: none."""

    seen: SeenCanopy
    note: str = ""


def site_canopy(
    site: Site,
    grid: GridGeometry,
    layers: FuelLayers,
    prior: FuelPrior | None,
    climate: FuelClimate,
    terrain: ConfirmedTerrain,
    evidence: EvidenceMap | None = None,
    state: Path | None = None,
) -> SiteCanopy:
    """Return the canopy of the cells of the fuel grid `grid` (in the map frame).

    Args:
        terrain: that of the same moment as the layers.
        evidence: what cameras have seen until now; None: not known, or the layers are of an earlier date.
        state: folder of the map's store, beside which that of the terrain may lie; None: not known, likewise."""
    bands = canopy_bands(layers, prior, climate)
    trees = forms_of(layers.code)[..., LifeForm.TREE - 1] & (bands[0] > 0)
    given = None if prior is None else prior.canopy
    new = layers.changed | (np.ones(trees.shape, np.bool_) if given is None else given[0] == NODATA)
    before = np.where(bands[0] > 0, bands[0], np.nan).astype(np.float64)
    tops = np.where(bands[1] > 0, bands[1] / 10.0, np.nan)
    heights, note = _heights(site, grid, state, tops)
    labels = None if evidence is None else evidence.label_cover(before)
    return SiteCanopy(measured_canopy(trees, new, seen_canopy(terrain, grid), labels, heights), note)


def _heights(
    site: Site, grid: GridGeometry, state: Path | None, before: Float64Array
) -> tuple[Float32Array | None, str]:
    """Return `stand_heights` from the terrain's store, and why it cannot be read; None without a store, and with a
    surface raster, which has these heights. `before`: metres, as in `stand_heights`."""
    path = None if state is None else state / STORE_FILE
    if path is None or site.terrain is None or site.surface is not None or not path.is_file():
        return None, ""
    try:
        surface = open_stored_surface(path, site)
        try:
            return stand_heights(surface, grid, before), ""
        finally:
            surface.close()
    except (ConfigError, StoreError, RasterError) as error:
        return None, f"heights of trees are not from the terrain map ({error})"


def provenance_of(
    site: Site,
    layers: FuelLayers,
    system: FuelSystem,
    moment_ns: int | None = None,
    landscape: Landscape | None = None,
    surface: SurfaceVersion | None = None,
    prior: FuelPrior | None = None,
) -> Provenance:
    """Return the provenance of a map's layers; `moment_ns`: the requested time, for which the newest frame is unknown.
    `surface`: the confirmed surface of its heights; None: the site's rasters. `prior`: the prior of a landscape's
    codes."""
    known = layers.code != NODATA
    cells = int(known.sum())
    newest = int(layers.last_seen.max()) if moment_ns is None else moment_ns
    looked = bool((layers.evidence > 0).any())
    as_of = iso_moment(newest) if newest > 0 else NOTHING_SEEN if not looked else WITHOUT_DATES
    # A map without dates is one of classes: its cells may be seen or the prior's.
    dated = moment_ns is None and as_of != WITHOUT_DATES
    seen = float((layers.evidence > 0)[known].mean()) if dated and cells else None
    changed = float(layers.changed[known].mean()) if cells else 0.0
    name = "none" if site.fuel.prior is None else site.fuel.prior.described()
    digest = hashlib.sha256(np.ascontiguousarray(layers.prior, "<i2").tobytes()).hexdigest()[:16]
    released = landfire_version(name)
    of_prior = "none" if site.fuel.prior is None else ", ".join(filter(None, (released, f"sha256 {digest}")))
    terrain = "" if landscape is None else landscape.terrain_note()
    shape = "" if surface is None else surface_note(surface)
    beside = prior is not None and prior.fbfm13 is not None and system is FuelSystem.FBFM13
    own = site.fuel.prior.own_fbfm13 if beside and site.fuel.prior is not None else ""
    climate = site.fuel.climate
    return Provenance(
        site.name, as_of, cells, seen, changed, name, of_prior, climate, system, software(), terrain, shape,
        labels_state(site), own,
    )  # fmt: skip
