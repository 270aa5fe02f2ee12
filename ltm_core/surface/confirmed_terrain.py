"""Hold the terrain of one version of the confirmed surface: bare earth, and what stands on it."""

from __future__ import annotations

from dataclasses import dataclass

from ltm_core.raster.dem import Dem
from ltm_core.surface.confirmed_surface import ConfirmedSurface
from ltm_core.surface.surface_manifest import AS_GIVEN, SurfaceVersion


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
