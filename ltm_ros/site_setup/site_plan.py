"""Plan a site, or the change of one, before anything is fetched, and carry the plan out in a temporary folder."""

import fcntl
import math
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pyproj import Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.geodesy import SiteFrame, map_problem, name_of, scale_problem
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Bounds
from ltm_core.raster.dem_stack import REACH, open_terrain
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import free_bytes, is_folder, is_there, require_folder
from ltm_ros.site_setup.camera_list import CameraValues, check_cameras, section
from ltm_ros.site_setup.layers import Layer, elevation_tiles, fine_tiles, local, write_dem, write_fuel, write_surface
from ltm_ros.site_setup.rasters import Tile, tiles_of
from ltm_ros.site_setup.request import Area, Kind, NoCoverageError, Progress
from ltm_ros.site_setup.site_writer import change_site, free_name, site_text
from ltm_ros.site_setup.source import Source
from ltm_ros.site_setup.sources import Choice, choose
from ltm_ros.site_setup.vertical import Datum, site_datum

_FILES: Mapping[Kind, str] = {"dem": "dem.tif", "coarser": "dem_coarse.tif", "surface": "surface.tif", "fuel": "fuel"}
_COARSE = 30.0
"""Smallest cell size of the coarser DEM in metres."""
_MARGIN_DEG = 0.002
"""Margin of an area in degrees, for the cells around its edge."""


@dataclass(frozen=True)
class Wish:
    """What the user wants. `files`: own rasters by key; `update`: the raster to replace, for an existing site."""

    out: Path
    name: str = ""
    lonlat: tuple[float, float] | None = None
    radius: float = 0.0
    crs: str | None = None
    cameras: Sequence[CameraValues] = ()
    files: Mapping[str, Sequence[Path]] = field(default_factory=dict)
    update: Kind | None = None

    @property
    def site_file(self) -> Path:
        return self.out / "site.yaml"


@dataclass(frozen=True)
class Step:
    """A raster to make, from the user's files, or from the source of `choice`."""

    key: Kind
    bounds: Bounds
    own: Sequence[Path] = ()
    choice: Choice | None = None


@dataclass
class SitePlan:
    """What will be fetched and written."""

    wish: Wish
    crs: str
    origin: tuple[float, float]
    steps: list[Step]
    remarks: list[str]
    site: Site | None = None
    """The site that is changed; None: a new one."""

    @property
    def expected_bytes(self) -> int:
        return sum(step.choice.plan.expected_bytes for step in self.steps if step.choice is not None)


def plan_site(wish: Wish, sources: Sequence[Source]) -> SitePlan:
    """Plan a site or its change. Raises ConfigError, RasterError, FetchError."""
    if is_there(wish.site_file):
        return _plan_change(wish, sources)
    if wish.update is not None:
        raise ConfigError(f"{wish.site_file}: no such site; make it first, without --update")
    if wish.lonlat is None or not wish.name:
        raise ConfigError("a new site needs --lonlat LON,LAT and --name NAME")
    if is_there(wish.out) and not (is_folder(wish.out) and not any(wish.out.iterdir())):
        raise ConfigError(f"{wish.out}: exists and is not an empty folder; name a new one")
    require_folder(wish.out, "the site")
    check_cameras(wish.cameras, {})
    lon, lat = wish.lonlat
    own = elevation_tiles(local(wish.files["dem"])) if wish.files.get("dem") else []
    crs = _site_crs(lon, lat, wish.crs, own)
    frame = SiteFrame(crs)
    x, y = map(float, frame.from_lonlat(lon, lat))
    fine = (x - wish.radius, y - wish.radius, x + wish.radius, y + wish.radius)
    if problem := scale_problem(crs, GridGeometry(fine[0], fine[3], wish.radius, 2, 2, crs)):
        raise ConfigError(f"--crs {crs}: {problem}")
    places = {camera.ros_name: frame.from_lonlat(camera.lon, camera.lat) for camera in wish.cameras}
    cameras = {name: (float(cx), float(cy)) for name, (cx, cy) in places.items()}
    remarks = _check_places(cameras, fine)
    plan = SitePlan(wish, crs, (round(x, -3), round(y, -3)), [], remarks)
    _add_step(plan, "dem", fine, sources)
    far = _around(fine, list(cameras.values()))
    if not own or any(_beyond(tile, fine, crs) for tile in own):
        _add_step(plan, "coarser", far, sources, optional=True)
    else:
        remarks.append("no coarser DEM: ridges beyond the DEM are unknown; add one with --update coarser")
    if wish.files.get("surface"):
        _add_step(plan, "surface", fine, sources)
    _add_step(plan, "fuel", fine, sources, optional=True)
    return plan


def _plan_change(wish: Wish, sources: Sequence[Source]) -> SitePlan:
    if wish.update is None and not wish.cameras:
        raise ConfigError(
            f"{wish.site_file}: exists already; change it with --update {'|'.join(_FILES)} or --camera, or name a new "
            "folder"
        )
    site = load_site(wish.site_file)
    check_cameras(wish.cameras, site.cameras)
    plan = SitePlan(wish, site.crs, site.origin, [], [], site)
    if wish.update is not None:
        stored = tiles_of([site.dem.path])[0]
        stated = (camera.pose or camera.mount for camera in site.cameras.values())
        placed = [pose.xy(SiteFrame(site.crs)) for pose in stated if pose is not None]
        far = _around(stored.bounds, [place for place in placed if place is not None])
        _add_step(plan, wish.update, far if wish.update == "coarser" else stored.bounds, sources)
    return plan


def _site_crs(lon: float, lat: float, given: str | None, own: Sequence[Tile]) -> str:
    """Return the CRS that was given, else that of the user's DEM if it is a map's, else the UTM zone of the place."""
    if given is not None:
        return SiteFrame(given).crs
    for tile in own:
        probe = Transformer.from_crs("EPSG:4326", tile.crs, always_xy=True).transform(lon, lat)
        x, y = (v if math.isfinite(v) else 0.0 for v in probe)
        if map_problem(tile.crs) is None and not scale_problem(tile.crs, GridGeometry(x, y, 1000.0, 2, 2)):
            return name_of(tile.crs)
    zones = query_utm_crs_info("WGS 84", AreaOfInterest(lon, lat, lon, lat), contains=True)
    if not zones:
        raise ConfigError(f"--lonlat {lon:g},{lat:g}: there is no UTM zone; give a projected CRS with --crs")
    return f"EPSG:{min(int(zone.code) for zone in zones)}"


def _check_places(cameras: Mapping[str, tuple[float, float]], fine: Bounds) -> list[str]:
    """Return a remark for each camera outside the fine DEM. Raises ConfigError for one that is too far away."""
    remarks = []
    for name, (x, y) in cameras.items():
        away = math.hypot(max(fine[0] - x, x - fine[2], 0.0), max(fine[1] - y, y - fine[3], 0.0))
        if away > REACH:
            raise ConfigError(
                f"camera {name} is {away / 1000:.0f} km from the site (at most {REACH / 1000:.0f} km); give longitude "
                "first, then latitude, or make it a site of its own"
            )
        if away > 0:
            remarks.append(
                f"camera {name} is {away / 1000:.1f} km outside the fine DEM, where the coarser one is used; increase "
                "--radius to include it"
            )
    return remarks


def _around(fine: Bounds, cameras: Sequence[tuple[float, float]]) -> Bounds:
    """Return the area that cameras may see: REACH around each of them, or around the middle of the fine DEM."""
    middle = ((fine[0] + fine[2]) / 2, (fine[1] + fine[3]) / 2)
    xs, ys = zip(*(cameras or [middle]), strict=True)
    margin = 4 * _COARSE
    return (
        min(min(xs) - REACH, fine[0] - margin), min(min(ys) - REACH, fine[1] - margin),
        max(max(xs) + REACH, fine[2] + margin), max(max(ys) + REACH, fine[3] + margin),
    )  # fmt: skip


def _beyond(tile: Tile, fine: Bounds, crs: str) -> bool:
    """Return whether a tile reaches more than a tenth of the site's width beyond it."""
    west, south, east, north = Transformer.from_crs(tile.crs, crs, always_xy=True).transform_bounds(*tile.bounds)
    margin = (fine[2] - fine[0]) / 10
    return west < fine[0] - margin or south < fine[1] - margin or east > fine[2] + margin or north > fine[3] + margin


def _add_step(plan: SitePlan, key: Kind, bounds: Bounds, sources: Sequence[Source], optional: bool = False) -> None:
    """Add a raster from the user's files, or from the best source. `optional`: without coverage it is left out."""
    own = plan.wish.files.get("dem" if key == "coarser" else key, ())
    if own:
        plan.steps.append(Step(key, bounds, own))
        return
    lonlat = Transformer.from_crs(plan.crs, "EPSG:4326", always_xy=True).transform_bounds(*bounds, densify_pts=21)
    west, south, east, north = lonlat
    area = Area((west - _MARGIN_DEG, south - _MARGIN_DEG, east + _MARGIN_DEG, north + _MARGIN_DEG))
    try:
        choice = choose(key, area, sources)
    except NoCoverageError as error:
        if not optional:
            raise
        plan.remarks.append(str(error))
        return
    plan.steps.append(Step(key, bounds, (), choice))
    plan.remarks += choice.plan.notes


def carry_out(plan: SitePlan, progress: Progress) -> tuple[dict[str, Layer], list[str]]:
    """Fetch, write the rasters and the site file; return the layers and remarks. A new site appears whole or not at
    all; a changed site names new files only when they are whole.

    Raises ConfigError, RasterError, FetchError."""
    wish = plan.wish
    needed, free = plan.expected_bytes * 3, free_bytes(wish.out)
    if free < needed:
        raise ConfigError(f"{wish.out}: needs about {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are free; make room")
    with _temporary(wish.out) as folder:
        layers, datum = _layers(plan, folder, progress)
        cameras: dict[str, dict[str, Any]] = {}
        remarks = [remark for layer in layers.values() for remark in layer.remarks]
        for camera in wish.cameras:
            cameras[camera.ros_name], said = section(camera, datum)
            remarks += said
        if plan.site is not None:
            moved = {}
            for key, layer in layers.items():
                moved[key] = replace(layer, path=wish.out / free_name(wish.out, layer.path.name))
                layer.path.rename(moved[key].path)
            try:
                change_site(wish.site_file, moved, cameras)
            except ConfigError:
                for layer in moved.values():
                    _remove(layer.path)
                raise
            return moved, remarks
        text = site_text(wish.name, plan.crs, plan.origin, datum, layers, cameras)
        (folder / "site.yaml").write_text(text, encoding="utf-8")
        load_site(folder / "site.yaml")
        folder.chmod(0o755)
        folder.replace(wish.out)
    return {key: replace(layer, path=wish.out / layer.path.name) for key, layer in layers.items()}, remarks


def _remove(path: Path) -> None:
    shutil.rmtree(path) if is_folder(path) else path.unlink()


@contextmanager
def _temporary(out: Path) -> Iterator[Path]:
    """Give a folder beside (or in) `out`, which is removed if it is still there at the end; one that a killed process
    left is removed first. Raises ConfigError if another process works on `out`, or the disk fails."""
    parent = out if is_folder(out) and any(out.iterdir()) else out.absolute().parent
    folder = parent / f".{out.name}.part"
    try:
        parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(exist_ok=True)
        lock = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for left in folder.iterdir():
                _remove(left)
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
        finally:
            os.close(lock)
    except BlockingIOError:
        raise ConfigError(f"{out}: another `ltm init` is writing it; wait until it ends") from None
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written ({error.strerror or error}); nothing was changed") from error


def _layers(plan: SitePlan, folder: Path, progress: Progress) -> tuple[dict[str, Layer], Datum | None]:
    """Make the rasters in a folder; return them and the vertical datum of the site."""
    layers: dict[str, Layer] = {}
    site = plan.site
    datum = None if site is None else tiles_of([site.dem.path])[0].datum
    for step in plan.steps:
        data = local(step.own)
        if step.choice is not None:
            fetched = folder / "sources" / step.key
            fetched.mkdir(parents=True)
            data = step.choice.fetch(fetched, progress)
        place = folder / _FILES[step.key]
        if step.key in ("dem", "coarser"):
            tiles = elevation_tiles(data)
            if step.key == "dem":
                tiles = fine_tiles(tiles, step.bounds, plan.crs)
                x, y = ((low + high) / 2 for low, high in zip(step.bounds[:2], step.bounds[2:], strict=True))
                lon, lat = SiteFrame(plan.crs).to_lonlat(x, y)
                datum = datum if site is not None else site_datum(tiles[0].datum, float(lon), float(lat))
            least = _COARSE if step.key == "coarser" else 0.0
            layers[step.key] = write_dem(place, data, tiles, step.bounds, plan.crs, datum, least)
        elif step.key == "surface":
            written = [layers[key].path for key in ("dem", "coarser") if key in layers]
            stated = [] if site is None else [(dem.path, dem.crs) for dem in (site.dem, *site.coarser)]
            dems: list[tuple[Path | str, str | None]] = [(path, None) for path in written] or [*stated]
            layers[step.key] = write_surface(place, data, step.bounds, plan.crs, datum, open_terrain(dems))
        else:
            size, phase = (30.0, 15.0) if site is None else (site.fuel.resolution, site.fuel.phase)
            grid = GridGeometry.snapped(step.bounds, size, phase, plan.crs)
            layers[step.key] = write_fuel(place, data, grid)
    shutil.rmtree(folder / "sources", ignore_errors=True)
    return layers, datum
