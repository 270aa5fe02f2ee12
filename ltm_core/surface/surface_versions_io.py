"""Keep versions of a site's confirmed surface on disk: one file each, named by its content, and a manifest.

A file is written once; the manifest, which names the version in use, is replaced in one step afterwards, so readers
find the previous version or the new one. Only the node `terrain` writes."""

import contextlib
import hashlib
import io
import itertools
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from ltm_core.base.errors import RasterError, StoreError
from ltm_core.base.strict_model import problem_text
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.storage.disk_io import sync
from ltm_core.surface.confirmed_surface import AS_GIVEN, KEPT, ConfirmedSurface, SurfaceManifest, SurfaceVersion

FOLDER = "surfaces"
"""Name of the folder beside the store of the terrain."""
MANIFEST = "surfaces.json"
_MOST_MANIFEST = 1 << 20
_MOST_FILE = 1 << 30
_ARRAYS = ("rows", "cols", "surface", "ground")


@dataclass(frozen=True)
class SurfaceVersions:
    """Versions of a site in a folder, which is created with the first one. `geometry`: of the terrain's grid, in the
    map frame; a version of another grid is rejected."""

    folder: Path
    site: str
    geometry: GridGeometry

    def manifest(self) -> SurfaceManifest:
        """Return the manifest, empty if there is none yet. Raises StoreError if it cannot be read or is of another
        site."""
        path = self.folder / MANIFEST
        try:
            found = SurfaceManifest.model_validate_json(_read(path, _MOST_MANIFEST))
        except ValidationError as error:
            problem = f"{path}: cannot be read as a list of surfaces ({problem_text(error)}); move the folder away"
            raise StoreError(problem) from error
        except StoreError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return SurfaceManifest(site=self.site)
            raise
        if found.site != self.site:
            raise StoreError(f"{path} is of site {found.site}, not {self.site}: give each site its own folder")
        return found

    def manifest_of_writer(self) -> tuple[SurfaceManifest, str]:
        """Return the manifest for writing: a folder with an unreadable manifest is moved away and started afresh, with
        a message about it (empty: none). Raises StoreError as `manifest` does for anything else."""
        try:
            return self.manifest(), ""
        except StoreError as error:
            if not isinstance(error.__cause__, ValidationError):
                raise
            places = (self.folder.with_name(f"{self.folder.name}.{number}") for number in itertools.count(1))
            aside = next(place for place in places if not place.exists())
            try:
                self.folder.rename(aside)
            except OSError as broken:
                raise StoreError(f"{error}; it could not be moved away ({broken.strerror or broken})") from broken
            afresh = f"{error}; it was moved to {aside}, and the list of surfaces starts afresh"
            return SurfaceManifest(site=self.site), afresh

    def file(self, version: str) -> Path:
        """Return the path of a version of the manifest."""
        return self.folder / f"surface-{version}.npz"

    def load(self, entry: SurfaceVersion) -> ConfirmedSurface:
        """Load a version's cells. Raises StoreError if its file is missing, modified, or of another grid."""
        path = self.file(entry.version)
        content = _read(path, _MOST_FILE)
        if hashlib.sha256(content).hexdigest() != entry.digest:
            raise StoreError(f"{path}: not the file written for this version; restart the node terrain")
        try:
            surface = _of_bytes(content)
        except (ValueError, KeyError, EOFError, zipfile.BadZipFile, RasterError) as error:
            raise StoreError(f"{path}: contains no confirmed surface ({error}); restart the node terrain") from error
        if surface.geometry != self.geometry:
            raise StoreError(
                f"{path}: has a grid of {surface.geometry.shape} cells of {surface.geometry.resolution} m, the terrain "
                f"has {self.geometry.shape} of {self.geometry.resolution} m: the site's DEM or terrain.resolution has "
                "changed; move the folder away"
            )
        return surface

    def add(self, surface: ConfirmedSurface, as_of_ns: int, seen: int) -> SurfaceVersion:
        """Write a version and make it the current one. Raises StoreError."""
        before, content = self.manifest(), _to_bytes(surface)
        digest = hashlib.sha256(content).hexdigest()
        counts = {"seen": seen, "changed": len(surface), "lowered": surface.lowered}
        entry = SurfaceVersion(
            version=digest[:16], digest=digest, parent=before.current, as_of_ns=as_of_ns,
            cells=self.geometry.width * self.geometry.height, **counts,
        )  # fmt: skip
        versions = (*before.versions, entry)
        kept, forgotten = versions[-KEPT:], before.forgotten or len(versions) > KEPT
        manifest = SurfaceManifest(site=before.site, versions=kept, forgotten=forgotten)
        self._write(self.file(entry.version), content)
        self._write(self.folder / MANIFEST, manifest.model_dump_json(indent=1).encode())
        # A writer that was killed may have left files that no manifest names.
        for path in {*self.folder.glob(f"surface-{'[0-9a-f]' * 16}.npz")} - {self.file(one.version) for one in kept}:
            with contextlib.suppress(OSError):
                path.unlink()
        return entry

    def _write(self, path: Path, content: bytes) -> None:
        """Write the file completely or not at all, even if the power fails."""
        partial = path.with_name(f".{path.name}.partial")
        try:
            self.folder.mkdir(exist_ok=True)
            partial.write_bytes(content)
            sync(partial)
            partial.replace(path)
            sync(self.folder)
        except OSError as error:
            raise StoreError(f"{path}: cannot be written ({error.strerror or error})") from error


def _read(path: Path, most: int) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error.strerror or error})") from error
    if len(content) > most:
        raise StoreError(f"{path}: cannot be read (it is larger than {most} bytes); move the folder away")
    return content


def _to_bytes(surface: ConfirmedSurface) -> bytes:
    """Return the same bytes for the same cells."""
    g, sink = surface.geometry, io.BytesIO()
    grid = np.array([g.x_min, g.y_max, g.resolution, g.width, g.height], np.float64)
    np.savez_compressed(sink, grid=grid, **{name: getattr(surface, name) for name in _ARRAYS})
    return sink.getvalue()


def _of_bytes(content: bytes) -> ConfirmedSurface:
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        x_min, y_max, resolution, width, height = (float(v) for v in file["grid"])
        arrays = {name: file[name] for name in _ARRAYS}
    for name, array in arrays.items():
        wanted = np.int32 if name in ("rows", "cols") else np.float32
        if array.dtype != wanted:
            raise ValueError(f"{name} is {array.dtype}, wanted {np.dtype(wanted)}")
    return ConfirmedSurface(GridGeometry(x_min, y_max, resolution, int(width), int(height)), **arrays)


@dataclass(frozen=True, eq=False)
class ConfirmedTerrain:
    """Ground and surface in the map frame, of one version of the confirmed surface (None: the site's rasters).

    `ground`: bare earth. `top`: what cameras see, with trees and houses where the site knows them; the same object as
    `ground` where nothing is known to stand. `surface`: the changed cells of the version. `canopy_known`: whether `top`
    has what stood before; False: only what has changed differs from `ground`. `note`: remark for the user."""

    version: SurfaceVersion | None
    ground: Dem
    top: Dem
    surface: ConfirmedSurface | None = None
    canopy_known: bool = True
    note: str = ""

    @property
    def name(self) -> str:
        """Return the name of the version in frames; AS_GIVEN if there is none."""
        return AS_GIVEN if self.version is None else self.version.version
