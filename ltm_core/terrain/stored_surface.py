"""Opens the surface map that a site's terrain node has stored, to look at it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from ltm_core.disk_io import is_file
from ltm_core.errors import ConfigError
from ltm_core.raster.tile_store import TileStore
from ltm_core.site import Site
from ltm_core.terrain.reference_surface import Reference
from ltm_core.terrain.surface_map import SurfaceMap
from ltm_core.terrain.tile_pool import KIND, schema_of

TERRAIN_STORE: Final = "terrain.sqlite"
"""Name of a site's store in the folder in which its terrain node keeps it."""


def open_stored_surface(path: Path, site: Site) -> SurfaceMap:
    """The surface map in a store (`terrain.sqlite`), also while a graph writes it; nothing is written to it.

    Raises ConfigError where there is no store, the site has no terrain, or the store is of another grid.
    """
    if site.terrain is None:
        raise ConfigError(f"site {site.name} has no section `terrain`; {path} needs that of the site that made it")
    if not is_file(path):
        raise ConfigError(f"{path}: no such file; a terrain store is terrain.sqlite in the folder that keeps the map")
    bare = site.open_dem()
    surface = site.open_surface(bare) if site.surface is not None else None
    reference = Reference.of(bare, surface, site.terrain.resolution)
    store = TileStore.open_read_only(path, KIND)
    if differences := schema_of(site.in_crs(reference.geometry)).differences(store.schema):
        store.close()
        raise ConfigError(f"{path}: not a terrain of site {site.name}: {differences}; name the site that made it")
    return SurfaceMap(reference, site.terrain, tuple(site.cameras), store, site.curvature, site.refraction)
