"""Open a fuel map for export: from a store, a bag, or a GeoTIFF of classes."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.base.resources import config_path
from ltm_core.fuel.canopy import seen_canopy
from ltm_core.fuel.class_map import UNSEEN, read_fuel_map
from ltm_core.fuel.codes import FuelClimate, FuelSystem
from ltm_core.fuel.decision import FuelLayers, layers_of_classes
from ltm_core.fuel.export.export_grid import make_landscape
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.export.provenance import Provenance
from ltm_core.fuel.prior import FuelPrior, load_prior, system_of
from ltm_core.geometry.geodesy import same_crs
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_fuel import provenance_of, site_evidence_map
from ltm_core.pipeline.site_surface import exported_terrain
from ltm_core.pipeline.stored_fuel import open_stored_map
from ltm_core.site.networks import with_live_record
from ltm_core.site.site import Site
from ltm_core.storage.config_io import read_text
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.confirmed_surface import SurfaceVersion
from ltm_core.surface.surface_versions_io import ConfirmedTerrain
from ltm_core.vision.labels import LabelSet
from ltm_ros.fuel_map.layers import layers_as_of, when

ACCURACY_FILE: Final = "accuracy.json"
"""File beside an assessed map's store; exports of the map carry its line as a tag."""
_LARGEST_ACCURACY: Final = 4096


@dataclass(frozen=True, eq=False)
class FuelSource:
    """A context manager. `geometry`: in the site's CRS. `empty`: the layers without evidence. `store`, `folder`: only
    for a store; `folder` contains it."""

    site: Site
    labels: LabelSet
    geometry: GridGeometry
    prior: FuelPrior | None
    layers: FuelLayers
    empty: FuelLayers
    store: TileStore | None = None
    folder: Path | None = None

    @classmethod
    def open(cls, path: Path, site: Site) -> "FuelSource":
        """Open a source. Raises LtmError for a file without a fuel map of this site."""
        labels = LabelSet.load(config_path(site.labels))
        if path.suffix == ".ltm":
            site = with_live_record(site, path.parent)
            evidence = site_evidence_map(site, site.fuel_geometry(site.open_dem()), labels)
            prior, empty = evidence.prior, evidence.layers()
            store, grid = open_stored_map(path, site, evidence), site.in_crs(evidence.geometry)
            return cls(site, labels, grid, prior, evidence.layers(), empty, store, path.parent)
        if path.suffix.lower() in (".tif", ".tiff"):
            classes, grid = read_fuel_map(path)
            if not same_crs(grid.crs, site.crs):
                raise RasterError(f"{path} is in {grid.crs}, the site in {site.crs}: export the site's own map")
        else:
            from ltm_ros.recordings.recorded_run import last_fuel_map

            classes, grid, _ = last_fuel_map(path, site)
        prior = None if site.fuel.prior is None else load_prior(site.fuel.prior, grid)
        climate = FuelClimate.named(site.fuel.climate)
        shown, empty = (layers_of_classes(one, prior, climate) for one in (classes, np.full_like(classes, UNSEEN)))
        unknown = np.full(classes.shape, np.nan, np.float32)  # classes do not say how certain they are
        return cls(site, labels, grid, prior, replace(shown, p_max=unknown, entropy=unknown), empty)

    @property
    def climate(self) -> FuelClimate:
        return FuelClimate.named(self.site.fuel.climate)

    def at(self, moment: str | None) -> FuelLayers:
        """Return the map now, or as of a time. Raises ConfigError for an invalid time, or without a history."""
        if moment is None:
            return self.layers
        if self.store is None:
            raise ConfigError(f"the map as of {moment} needs a store (.ltm), which keeps its history")
        return layers_as_of(self.store, self.empty, when(moment))

    def terrain(self, moment: str | None = None) -> ConfirmedTerrain:
        """Return the terrain: the surface in use at that time, if the site uses the confirmed one and keeps it beside
        the store. Raises ConfigError as `at`, StoreError."""
        return exported_terrain(self.site, self.folder, None if moment is None else when(moment))

    def landscape(
        self, system: FuelSystem, moment: str | None = None, target: GridGeometry | None = None
    ) -> tuple[Landscape, Provenance, list[str]]:
        """Return the landscape now, or as of a time, on the map's grid or on `target`, its provenance, and notes about
        its heights. Raises as `at` and `terrain`."""
        site, layers, terrain = self.site, self.at(moment), self.terrain(moment)
        landscape = make_landscape(
            *(layers, self.prior, terrain.ground, site.frame, self.geometry, self.climate, system, target),
            seen_canopy(terrain, site.in_map(self.geometry)),
        )
        made = self.provenance(layers, terrain.version, moment, system, landscape)
        return landscape, made, [terrain.note] if terrain.note else []

    def provenance(
        self,
        layers: FuelLayers,
        surface: SurfaceVersion | None,
        moment: str | None = None,
        system: FuelSystem | None = None,
        landscape: Landscape | None = None,
    ) -> Provenance:
        """Return the provenance of an export; `layers`: as `at` returns them; `surface`: version of the heights."""
        as_of, system = None if moment is None else when(moment), system or system_of(self.prior)
        made = provenance_of(self.site, layers, system, as_of, landscape, surface, self.prior)
        return replace(made, accuracy=self._accuracy())

    def _accuracy(self) -> str:
        """Return the accuracy that `ltm assess report` wrote beside the store; empty if there is none."""
        if self.folder is None or not (path := self.folder / ACCURACY_FILE).is_file():
            return ""
        try:
            return str(json.loads(read_text(path, _LARGEST_ACCURACY, ConfigError))["accuracy"])
        except (ValueError, KeyError, TypeError) as error:
            raise ConfigError(f"{path}: is invalid ({error}); write it again with `ltm assess report`") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: Any) -> None:
        if self.store is not None:
            self.store.close()
