"""Make the evidence map of a site's fuels, and the provenance of its exports."""

import hashlib
from collections.abc import Sequence

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.codes import FuelClimate, FuelSystem
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.export.landscape import Landscape
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
from ltm_core.fuel.life_form import NODATA, label_forms
from ltm_core.fuel.prior import FuelPrior, load_prior
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.site.networks import camera_label_errors, labels_state, site_label_errors
from ltm_core.site.site import Site
from ltm_core.surface.confirmed_surface import SurfaceVersion
from ltm_core.vision.labels import LabelSet


def site_evidence_map(
    site: Site, geometry: GridGeometry, labels: LabelSet, given: LabelErrors | None = None
) -> EvidenceMap:
    """Return an empty map on the fuel grid (`Site.fuel_geometry`, in the map frame) over the site's prior.

    `given`: label errors instead of the known ones. Raises ConfigError and RasterError for a climate, label errors or
    prior that cannot be taken."""
    fuel = site.fuel
    prior = None if fuel.prior is None else load_prior(fuel.prior, site.in_crs(geometry))
    climate = FuelClimate.named(fuel.climate)
    errors, of_cameras = (site_label_errors(site), camera_label_errors(site)) if given is None else (given, {})
    return EvidenceMap(geometry, prior, labels, fuel.fusion, errors, climate, of_cameras)


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

    prior = site_evidence_map(site, geometry, labels, UNMEASURED).prior
    if prior is None:
        raise ConfigError(f"site {site.name} has no prior map (fuel.prior); labels are measured against one")

    def changes(errors: LabelErrors, of: Sequence[CellVotes] = votes) -> UInt8Array:
        evidence = site_evidence_map(site, geometry, labels, errors)
        for frame in of:
            evidence.add(frame)
        layers = evidence.layers()
        return np.where(layers.changed, layers.life_form, 0).astype(np.uint8)

    known = None if reference is None else changes(*reference)
    reach = site.fuel.fusion.context_cells
    return measure_labels(votes, prior.codes, label_forms(labels), reach, changes, known, source)


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
    known, seen = layers.code != NODATA, layers.evidence > 0
    cells = int(known.sum())
    newest = int(layers.last_seen.max()) if moment_ns is None else moment_ns
    as_of = iso_moment(newest) if newest > 0 else WITHOUT_DATES if seen.any() else NOTHING_SEEN
    # A map without dates is one of classes: its cells may be seen or the prior's.
    dated = moment_ns is None and as_of != WITHOUT_DATES
    given, name, version, own = site.fuel.prior, "none", "none", ""
    if given is not None:
        digest = hashlib.sha256(np.ascontiguousarray(layers.prior, "<i2").tobytes()).hexdigest()[:16]
        name = given.described()
        version = ", ".join(filter(None, (landfire_version(name), f"sha256 {digest}")))
        beside = prior is not None and prior.fbfm13 is not None and system is FuelSystem.FBFM13
        own = given.own_fbfm13 if beside else ""
    seen_share = float(seen[known].mean()) if dated and cells else None
    changed = float(layers.changed[known].mean()) if cells else 0.0
    terrain = "" if landscape is None else landscape.terrain_note()
    shape = "" if surface is None else surface_note(surface)
    return Provenance(
        site.name, as_of, cells, seen_share, changed, name, version, site.fuel.climate, system, software(), terrain,
        shape, labels_state(site), own,
    )  # fmt: skip
