"""The terrain of a site as its cameras have confirmed it: what later frames are traced to, and what maps export."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from ltm_core.dem import Dem
from ltm_core.errors import StoreError
from ltm_core.grid import GridGeometry
from ltm_core.raster.confirmed_surface import ConfirmedSurface
from ltm_core.raster.shared_rasters import shared
from ltm_core.raster.surface_versions_io import AS_GIVEN, FOLDER, SurfaceVersion, SurfaceVersions
from ltm_core.site import Site


@dataclass(frozen=True, eq=False)
class ConfirmedTerrain:
    """Two terrains in the map frame, of one version of the confirmed surface (None: as the site's rasters give them).

    `ground`: bare earth. `top`: what cameras see, with trees and houses where the site knows them; the same object as
    `ground` where nothing is known to stand. `surface`: the changed cells of the version. `canopy_known`: whether `top`
    has what stood before; False: only what has changed differs from `ground`. `given`: `top` as it was given, of a
    version; None: not known. `note`: what is to be told of it.
    """

    version: SurfaceVersion | None
    ground: Dem
    top: Dem
    surface: ConfirmedSurface | None = None
    canopy_known: bool = True
    given: Dem | None = None
    note: str = ""

    @property
    def name(self) -> str:
        """The version, as frames carry it; AS_GIVEN where there is none."""
        return AS_GIVEN if self.version is None else self.version.version

    @classmethod
    def as_given(cls, site: Site) -> ConfirmedTerrain:
        """Raises what `Site.open_dem` does."""
        ground = site.open_dem()
        return cls(None, ground, site.open_surface(ground), canopy_known=site.surface is not None)

    @classmethod
    def of(cls, site: Site, versions: SurfaceVersions, name: str) -> ConfirmedTerrain:
        """The terrain of a version that the manifest lists, shared within the process; AS_GIVEN: as given.

        Raises StoreError where the version is not listed or cannot be read, and what `Site.open_dem` does.
        """
        if name == AS_GIVEN:
            return cls.as_given(site)
        entry = versions.manifest().entry(name)
        if entry is None:
            raise StoreError(f"{versions.folder}: no confirmed surface {name!r} there; it may be too old to be kept")
        # Before the rasters: who follows tries a file that is damaged again and again.
        surface = versions.load(entry)
        given = cls.as_given(site)
        rasters = [dem.path for dem in (site.dem, *site.coarser, *([site.surface] if site.surface else []))]
        files = [versions.file(name), *rasters]
        ground, top = (
            shared(files, (what, site.frame), lambda make=make, under=under: make(under))  # type: ignore[misc]
            for what, make, under in (
                ("confirmed ground", surface.ground_over, given.ground),
                ("confirmed surface", surface.surface_over, given.top),
            )
        )
        return cls(entry, ground, top, surface, given.canopy_known, given.top)


def surface_versions(site: Site, folder: Path) -> SurfaceVersions:
    """Those that a site's terrain node keeps in `folder`. Raises what `Site.open_dem` does."""
    resolution = None if site.terrain is None else site.terrain.resolution
    return SurfaceVersions(folder, site.name, terrain_grid(site.open_dem().geometry, resolution))


def exported_terrain(site: Site, state: Path | None, moment_ns: int | None = None) -> ConfirmedTerrain:
    """The terrain that a map exports whose store lies in the folder `state`: as confirmed, now or at a moment, where
    the site asks for that and its terrain keeps its surfaces there too; else bare earth as given, and nothing that
    stands on it: no export asks for that then, and the surface raster stays closed. Raises StoreError, also for a
    moment of which no surface is kept any more.
    """
    note = ""
    if state is not None and site.terrain is not None and site.terrain.trace_confirmed:
        versions = surface_versions(site, state / FOLDER)
        entry = versions.manifest().at(moment_ns)
        if entry is not None:
            return replace(ConfirmedTerrain.of(site, versions, entry.version), version=entry)
        if not versions.folder.is_dir():
            note = (
                f"the site follows the confirmed surface, but {versions.folder} is not there: heights are bare earth "
                "as given; keep fuel map and terrain in one folder (ltm run --state)"
            )
    ground = site.open_dem()
    return ConfirmedTerrain(None, ground, ground, canopy_known=False, note=note)


def terrain_grid(dem: GridGeometry, resolution: float | None) -> GridGeometry:
    """The grid of a site's `terrain` node, in the map frame: the DEM's, or over it with cells of `resolution`."""
    cell = resolution or dem.resolution
    height, width = (max(2, round(n * dem.resolution / cell)) for n in dem.shape)
    return GridGeometry(dem.x_min, dem.y_max, cell, width, height, dem.crs)
