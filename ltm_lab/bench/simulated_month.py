"""Draw a month of two towers' images: weather, nights, a felled stand, a burn, and a camera that is stuck for a week.

The images are drawn, not rendered: the ground has the colour of its plants, lit by the sun of the hour and hazier with
distance. Terrain, plants and a prior map that is partly wrong are those of the fuel map's trials.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml
from mcap.writer import CompressionType
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.fuel.life_form import LifeForm
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, sun_elevation
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_lab.bench.colour_network import NETWORK, write_colour_network
from ltm_lab.evaluation.fuel.trial_country import SUBCELLS, World, majority_of, make_world
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, encode_rgb
from ltm_ros.runtime.topics import IMAGE_COMPRESSED, camera_topic

NAME, CRS, ORIGIN = "month", "EPSG:32611", (480_000.0, 4_150_020.0)
CAMERA = Camera.from_fov(320, 180, 62.0)
A_DAY = 24
"""Images of a camera per day."""
BEGIN_NS = int(np.datetime64("2026-08-01T00:20", "ns").astype(np.int64))
HOUR_NS = 3600 * 10**9
FELLED_DAY, BURNED_DAY, STUCK_DAYS = 8, 18, range(20, 27)
_BURNED_HOUR = 21
"""Hour of the burn, UTC: early afternoon at the site."""
_RADIUS = 9
"""Radius of the felled and of the burnt area, fuel cells."""
_BURNED = 0
"""Plant code of burnt ground."""
_COLOURS = {
    LifeForm.GRASS: (170, 155, 80),
    LifeForm.SHRUB: (110, 125, 70),
    LifeForm.TREE: (35, 75, 35),
    LifeForm.BARE: (175, 160, 150),
    _BURNED: (38, 34, 32),
}
_CLASSES = {
    "sky": (195, 212, 235),
    "grass": _COLOURS[LifeForm.GRASS],
    "shrub": _COLOURS[LifeForm.SHRUB],
    "tree": _COLOURS[LifeForm.TREE],
    "soil": _COLOURS[LifeForm.BARE],
    "ash": _COLOURS[_BURNED],
}
_MAPPING = {"sky": "sky", "grass": "grass", "shrub": "shrub", "tree": "tree", "soil": "bare", "ash": "bare"}
_SKY, _HAZE, _GRAIN = (195, 212, 235), (165, 180, 198), 3.0


@dataclass(frozen=True, eq=False)
class Month:
    """A simulated month. Each of `bags` has ten days; `felled` are (H, W) cells of `grid`, in the map frame."""

    site: Path
    bags: tuple[Path, ...]
    burns: Path
    frames: int
    grid: GridGeometry
    felled: BoolArray


class _View:
    """The view of a fixed camera, traced once."""

    def __init__(self, world: World, pose: Pose, fine: GridGeometry) -> None:
        shown = TerrainTracer(world.dem, possible=NOTHING_BEYOND).trace(CAMERA, pose)
        self.pose, self.range, points = pose, shown.range, shown.points()
        row, col = fine.cell_of(np.nan_to_num(points[..., 0], posinf=0.0), np.nan_to_num(points[..., 1], posinf=0.0))
        self.sky = ~np.isfinite(shown.range)
        self.seen = ~self.sky & fine.contains(row, col)
        self.cell = np.where(self.seen, row, 0), np.where(self.seen, col, 0)
        down, right = np.asarray(np.gradient(world.dem.elevation, world.dem.geometry.resolution))
        x, y = (np.nan_to_num(points[..., axis], posinf=0.0) for axis in (0, 1))
        row, col = (np.clip(at, 0, n - 1) for at, n in zip(
            world.dem.geometry.cell_of(x, y), world.dem.elevation.shape, strict=True
        ))  # fmt: skip
        self.slope = np.stack([-right[row, col], down[row, col]], axis=-1)
        """Components of the ground's normal to the east and to the north, (h, w, 2)."""


def write_month(folder: Path, say: Callable[[str], None], days: int, seed: int) -> Month:
    """Write the month of a seed into an existing empty folder; `say` reports the progress."""
    world = make_world(seed, 0.1)
    fine = GridGeometry(
        world.geometry.x_min,
        world.geometry.y_max,
        world.geometry.resolution / SUBCELLS,
        world.geometry.width * SUBCELLS,
        world.geometry.height * SUBCELLS,
    )
    names = {f"tower_{k}": Pose.from_angles(tower, _to_middle(tower), -8.0) for k, tower in enumerate(world.towers[:2])}
    views = {name: _View(world, pose, fine) for name, pose in names.items()}
    seen = np.zeros(world.geometry.shape)
    for view in views.values():
        np.add.at(seen, tuple(index[view.seen] // SUBCELLS for index in view.cell), 1.0)
    forms = majority_of(world.fine)
    felled = _disc(np.minimum(seen, 6) * (forms == LifeForm.TREE)) & (forms == LifeForm.TREE)
    burned = _disc(np.minimum(seen, 6) * np.isin(forms, (LifeForm.GRASS, LifeForm.SHRUB)) * ~_near(felled))
    _write_site(folder, world, names)
    _write_burn(folder / "burns.geojson", burned, world.geometry, days)
    bags = []
    for first in range(0, days, 10):
        say(f"drawing day {first + 1} of {days}")
        last = min(first + 10, days)
        bags.append(_write_bag(folder / f"days_{first + 1}", world, views, (felled, burned), range(first, last), seed))
    return Month(folder / "site.yaml", tuple(bags), folder / "burns.geojson", 2 * days * A_DAY, world.geometry, felled)


def _write_bag(
    path: Path, world: World, views: dict[str, _View], changed: tuple[BoolArray, BoolArray], days: range, seed: int
) -> Path:
    still: dict[str, bytes] = {}
    with BagWriter(path, compression=CompressionType.NONE) as bag:
        for hour in range(days.start * A_DAY, days.stop * A_DAY):
            for number, (name, view) in enumerate(views.items()):
                stamp = BEGIN_NS + hour * HOUR_NS + number * 60 * 10**9
                stuck = number == 1 and hour // A_DAY in STUCK_DAYS
                if not stuck or name not in still:
                    noon = hour // A_DAY * A_DAY + _BURNED_HOUR if stuck else hour
                    picture = _drawn(world, view, changed, BEGIN_NS + noon * HOUR_NS, noon, [seed, number, noon])
                    still[name] = encode_rgb(picture, quality=85)
                message = compressed_to_msg(still[name], "jpeg", stamp, f"{name}_optical")
                bag.write(camera_topic(NAME, name, IMAGE_COMPRESSED), message, stamp)
    return path


def _drawn(
    world: World, view: _View, changed: tuple[BoolArray, BoolArray], stamp_ns: int, hour: int, seed: list[int]
) -> UInt8Array:
    """Return the image (180, 320, 3) of an hour since the beginning; `seed` draws its noise."""
    rng, weather = np.random.default_rng(seed), np.random.default_rng([seed[0], 77, hour // A_DAY])
    clouds, far = weather.uniform(0.0, 0.5), weather.choice([25_000.0, 12_000.0, 6_000.0])
    foggy = weather.random() < 0.25 and hour % A_DAY in range(12, 19)
    felled, burned = (np.kron(mask, np.ones((SUBCELLS, SUBCELLS), bool)) for mask in changed)
    plants = world.fine.copy()
    if hour >= FELLED_DAY * A_DAY:
        plants[felled] = LifeForm.BARE
    if hour > BURNED_DAY * A_DAY + _BURNED_HOUR:
        plants[burned] = _BURNED
    palette = np.zeros((256, 3))
    for form, colour in _COLOURS.items():
        palette[form] = colour
    longitude, latitude = (float(np.radians(angle)) for angle in SiteFrame(CRS, *ORIGIN).to_lonlat(0.0, 0.0))
    height = float(sun_elevation(latitude, longitude, [stamp_ns])[0])
    day = float(np.clip((np.degrees(height) + 6) / 14, 0.03, 1.0))
    toward = (hour % A_DAY - 20) / 24 * 2 * np.pi + np.pi  # the sun's azimuth, roughly: south at 20 h UTC
    slope = view.slope[..., 0] * np.sin(toward) + view.slope[..., 1] * np.cos(toward)
    lit = np.clip(0.95 + 0.35 * (1 - clouds) * slope, 0.6, 1.15) * (1 - 0.25 * clouds) * day
    ground = palette[plants[view.cell]] * lit[..., None]
    clear = np.exp(-np.where(view.sky, 0.0, view.range) / (40.0 if foggy else far))[..., None]
    photo = np.where(view.sky[..., None], np.array(_SKY) * day, ground * clear + np.array(_HAZE) * day * (1 - clear))
    if foggy:
        photo = np.where(view.sky[..., None], np.array(_HAZE) * day, photo)
    axis = view.pose.rotation[:, 2]
    if 0 < height < np.radians(14) and np.sin(toward) * axis[0] + np.cos(toward) * axis[1] > 0.6:
        photo = photo + 250 * np.exp(
            -((np.indices(view.sky.shape)[0][..., None] - 50) ** 2) / 12_000
        )  # sun in the lens
    photo = cv2.GaussianBlur(photo, (0, 0), 0.6) + _GRAIN * rng.standard_normal(photo.shape)
    return np.asarray(np.clip(photo, 0, 255), np.uint8)


def _write_site(folder: Path, world: World, poses: dict[str, Pose]) -> None:
    def in_crs(grid: GridGeometry) -> GridGeometry:
        x, y = grid.x_min + ORIGIN[0], grid.y_max + ORIGIN[1]
        return GridGeometry(x, y, grid.resolution, grid.width, grid.height, CRS)

    write_geotiff(folder / "dem.tif", world.dem.elevation, in_crs(world.dem.geometry), nodata=float("nan"))
    write_geotiff(folder / "prior.tif", world.prior.codes, in_crs(world.geometry), nodata=-9999)
    write_colour_network(folder, _CLASSES, _MAPPING, (CAMERA.width, CAMERA.height))
    calibration = {name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    cameras = {}
    for name, pose in poses.items():
        (x, y, z), (azimuth, pitch, _) = pose.position, pose.angles_deg
        place = {"x": float(x + ORIGIN[0]), "y": float(y + ORIGIN[1]), "z": float(z)}
        angles = {"azimuth_deg": float(azimuth), "pitch_deg": float(pitch)}
        # Smoke is detected with earlier images, which an archive's tasks do not have.
        cameras[name] = {"calibration": calibration, "pose": place | angles}
    site = {
        "name": NAME,
        "crs": CRS,
        "origin": list(ORIGIN),
        "dem": {"path": "dem.tif"},
        "possible_ground": {"highest": 0.0},
        "model": NETWORK,
        "fuel": {"prior": {"path": "prior.tif"}},
        "expert": {"fuel": {"max_range": 3000.0}, "cameras": {name: {"judge_smoke": False} for name in cameras}},
        "nodes": {"fuel_map": {"max_behind": 1e9, "max_ahead": 1e9}, "capture": {"drop_repeated": True}},
        "cameras": cameras,
    }
    (folder / "site.yaml").write_text(yaml.safe_dump(site), encoding="utf-8")


def _write_burn(path: Path, burned: BoolArray, grid: GridGeometry, days: int) -> None:
    """Write the burn as one square per cell."""
    moment = np.datetime64(BEGIN_NS + (BURNED_DAY * A_DAY + _BURNED_HOUR) * HOUR_NS + 1800 * 10**9, "ns")
    frame, squares = SiteFrame(CRS, *ORIGIN), []
    for row, col in np.argwhere(burned) if days > BURNED_DAY else ():
        corners = [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)]
        ring = [
            [float(v) for v in frame.to_lonlat(
                grid.x_min + (col + right) * grid.resolution, grid.y_max - (row + down) * grid.resolution
            )]
            for right, down in corners
        ]  # fmt: skip
        squares.append([ring])
    feature = {
        "type": "Feature",
        "properties": {"burned_at": str(moment.astype("datetime64[s]"))},
        "geometry": {"type": "MultiPolygon", "coordinates": squares},
    }
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}), encoding="utf-8")


def _to_middle(tower: tuple[float, float, float]) -> float:
    """Return the azimuth from a tower to the middle of the terrain, degrees."""
    return float(np.degrees(np.arctan2(-tower[0], -tower[1])) % 360)


def _disc(worth: Float64Array) -> BoolArray:
    """Return the cells (H, W) around the place with the largest sum of `worth`."""
    total = ndimage.uniform_filter(worth.astype(np.float64), 2 * _RADIUS, mode="constant")
    row, col = np.unravel_index(total.argmax(), total.shape)
    rows, cols = np.indices(worth.shape)
    return np.asarray(np.hypot(rows - row, cols - col) < _RADIUS)


def _near(cells: BoolArray) -> BoolArray:
    return np.asarray(ndimage.binary_dilation(cells, iterations=2 * _RADIUS))
