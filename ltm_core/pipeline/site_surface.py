"""Create the surface map of a site, the terrain that its cameras have confirmed, and the terrain for pose
estimation."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.base.resources import config_path
from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.picture_pose_config import BARE_EARTH, CANOPY_SURFACE
from ltm_core.raster.dem_stack import shared
from ltm_core.site.networks import site_label_errors
from ltm_core.site.site import Site
from ltm_core.storage.disk_io import is_file
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import StoreSchema
from ltm_core.surface.confirmed_surface import AS_GIVEN
from ltm_core.surface.observation import DepthFrame
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import Added, SurfaceMap
from ltm_core.surface.surface_versions_io import FOLDER, ConfirmedTerrain, SurfaceVersions
from ltm_core.surface.tile_pool import KIND, schema_of
from ltm_core.vision.labels import LabelSet


def given_terrain(site: Site) -> ConfirmedTerrain:
    """Return the terrain as the site's rasters give it. Raises what `Site.open_dem` does."""
    ground = site.open_dem()
    return ConfirmedTerrain(None, ground, site.open_surface(ground), canopy_known=site.surface is not None)


def confirmed_terrain(site: Site, versions: SurfaceVersions, name: str) -> ConfirmedTerrain:
    """Return the terrain of a version that the manifest lists, shared within the process; AS_GIVEN: as given.

    Raises StoreError if the version is not listed or cannot be read, and what `Site.open_dem` does."""
    if name == AS_GIVEN:
        return given_terrain(site)
    entry = versions.manifest().entry(name)
    if entry is None:
        raise StoreError(f"{versions.folder}: no confirmed surface {name!r}; old ones are deleted")
    # The version first: a follower tries a damaged file again and again, and must not read the rasters each time.
    surface = versions.load(entry)
    given = given_terrain(site)
    rasters = [dem.path for dem in (site.dem, *site.coarser, *([site.surface] if site.surface else []))]
    files = [versions.file(name), *rasters]
    ground, top = (
        shared(files, (what, site.frame), lambda make=make, under=under: make(under))  # type: ignore[misc]
        for what, make, under in (
            ("confirmed ground", surface.ground_over, given.ground),
            ("confirmed surface", surface.surface_over, given.top),
        )
    )
    return ConfirmedTerrain(entry, ground, top, surface, given.canopy_known)


def surface_versions(site: Site, folder: Path) -> SurfaceVersions:
    """Return the surface versions that a site's terrain node keeps in `folder`. Raises as `Site.open_dem`."""
    resolution = None if site.terrain is None else site.terrain.resolution
    return SurfaceVersions(folder, site.name, terrain_grid(site.open_dem().geometry, resolution))


def exported_terrain(site: Site, state: Path | None, moment_ns: int | None = None) -> ConfirmedTerrain:
    """Return the terrain for exports of a map whose store is in the folder `state`: as confirmed, now or at a time, if
    the site enables it and its terrain keeps its surfaces there; else bare earth as given. Raises StoreError, also for
    a time whose surface is not kept any more."""
    note = ""
    if state is not None and site.terrain is not None and site.terrain.trace_confirmed:
        versions = surface_versions(site, state / FOLDER)
        entry = versions.manifest().at(moment_ns)
        if entry is not None:
            return replace(confirmed_terrain(site, versions, entry.version), version=entry)
        if not versions.folder.is_dir():
            note = (
                f"the site follows the confirmed surface, but {versions.folder} is not there: heights are bare earth "
                "as given; keep fuel map and terrain in one folder (ltm run --state)"
            )
    ground = site.open_dem()
    return ConfirmedTerrain(None, ground, ground, canopy_known=False, note=note)


def terrain_grid(dem: GridGeometry, resolution: float | None) -> GridGeometry:
    """Return the grid of a site's `terrain` node, in the map frame: the DEM's, or over it with cells of
    `resolution`."""
    cell = resolution or dem.resolution
    height, width = (max(2, round(n * dem.resolution / cell)) for n in dem.shape)
    return GridGeometry(dem.x_min, dem.y_max, cell, width, height, dem.crs)


STABLE_CLASSES = ("grass", "bare", "built")
"""Classes whose surface does not move; frames are registered on them."""
UNCOMMITTED = 500
"""Maximum number of frames that wait to be stored."""


class SiteTerrain:
    """The surface map `map` of a site with a section `terrain`, in the `store` that `open_store` gives for its schema.

    Raises ConfigError for a site without that section, and as `Site.open_dem` and `SurfaceMap` do."""

    def __init__(self, site: Site, open_store: Callable[[StoreSchema], TileStore]) -> None:
        if site.terrain is None:
            raise ConfigError(
                f"site {site.name}: has no section `terrain`; add one (`terrain: {{}}` takes the defaults)"
            )
        labels = LabelSet.load(config_path(site.labels))
        self._stable = np.zeros(256, np.bool_)
        self._stable[[labels.id_of(name) for name in STABLE_CLASSES]] = True
        reference = _reference(site, site.terrain.resolution)
        self.store = open_store(schema_of(site.in_crs(reference.geometry)))
        self.map = SurfaceMap(
            reference,
            site.terrain,
            tuple(site.cameras),
            self.store,
            site.curvature,
            site.refraction,
            site_label_errors(site).open_odds(),
            site.assumed_pose_error,
        )

    def add(
        self,
        depth: Float32Array,
        sigma: Float32Array,
        camera: Camera,
        pose: Pose,
        stamp_ns: int,
        source: str,
        covariance: Float64Array | None,
        labels: UInt8Array | None,
    ) -> Added:
        """Take in what was measured in a photo of `camera`; arguments as of `DepthFrame.of_photo`. Raises LtmError as
        it and `SurfaceMap.add` do."""
        frame = DepthFrame.of_photo(depth, sigma, camera, pose, stamp_ns, source, covariance, labels)
        if frame.labels is not None:
            frame = replace(frame, stable=self._stable[frame.labels])
        return self.map.add(frame)


def _reference(site: Site, resolution: float | None) -> Reference:
    bare = site.open_dem()
    return Reference.of(bare, None if site.surface is None else site.open_surface(bare), resolution)


STORE_FILE: Final = "terrain.sqlite"
"""Name of a site's store in the folder of its terrain node."""


def open_stored_surface(path: Path, site: Site) -> SurfaceMap:
    """Open the surface map in a store (`terrain.sqlite`) read-only, also while a graph writes it.

    Raises ConfigError where there is no store, the site has no terrain, or the store is of another grid."""
    if site.terrain is None:
        raise ConfigError(f"site {site.name} has no section `terrain`; use the site file that created {path}")
    if not is_file(path):
        raise ConfigError(f"{path}: no such file; the terrain store is terrain.sqlite in the folder of the map")
    reference = _reference(site, site.terrain.resolution)
    store = TileStore.open_read_only(path, KIND)
    if differences := schema_of(site.in_crs(reference.geometry)).differences(store.schema):
        store.close()
        raise ConfigError(
            f"{path}: not a terrain of site {site.name}: {differences}; use the site file that created it"
        )
    return SurfaceMap(reference, site.terrain, tuple(site.cameras), store, site.curvature, site.refraction)


def mount_terms(site: Site, camera: str, seen: Camera | None) -> str:
    """Return the hexadecimal SHA-256 of all inputs of a correction of a camera's poses. `seen`: the calibration of its
    images; None if the site states none. Raises StoreError for a missing raster."""
    stated = site.camera(camera).model_dump(mode="json", include={"pose", "mount", "sensors", "calibration"})
    rasters = [site.dem, *site.coarser, *([] if site.surface is None else [site.surface])]
    try:
        files = [(raster.path.name, (at := raster.path.stat()).st_size, at.st_mtime_ns) for raster in rasters]
    except OSError as error:
        raise StoreError(f"{error.filename}: {error.strerror}; correct `dem` in the site file") from error
    ground = [files, site.crs, site.origin, site.bend, site.possible_ground.model_dump(mode="json")]
    lens = None if seen is None else [seen.width, seen.height, seen.fx, seen.fy, seen.cx, seen.cy, *seen.distortion]
    return hashlib.sha256(json.dumps([stated, ground, lens], sort_keys=True).encode()).hexdigest()


def site_terrain(site: Site) -> SearchTerrain:
    """Return the site's ground, with the tops of trees if it has a surface raster. Raises as `Site.open_dem`."""
    bare = site.open_dem()
    ground = site.open_surface(bare)
    return SearchTerrain(ground, site.bend, site.possible_ground, BARE_EARTH if ground is bare else CANOPY_SURFACE)
