"""Finds and reads the real photos that the gallery shows, and what people have said of them."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.errors import ConfigError, ImageError
from ltm_core.base.types import BoolArray, RgbImage, UInt8Array
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.pose_estimation.points.resection_io import read_control_points
from ltm_core.raster.dem import Dem
from ltm_core.storage.config_io import load_yaml
from ltm_core.storage.image_io import read_rgb, read_values
from ltm_lab.evaluation.gallery.parts import Part
from ltm_lab.evaluation.terrain.canyon_io import PHOTOS, SURVEYS
from ltm_lab.resources import lab_config
from ltm_lab.training.photo_sets import PhotoSets

ENGABREEN = SiteFrame("EPSG:32633", 446_000.0, 7_396_000.0)
ENGABREEN_PHOTOS = ("IMG_8902.jpg", "IMG_8937.jpg")
"""The control points are those of the first."""
MOUNTAINS_EVERY = 2
_NAMED = 6
"""Missing files that a message names."""


@dataclass(frozen=True, eq=False)
class NamedPhoto:
    """A photo with the class ids that a person gave to parts of it, 255 elsewhere; None without such a drawing.

    `mountain`: where a person saw a mountain, which is never sky; None if not stated."""

    name: str
    photo: RgbImage
    truth: UInt8Array | None
    mountain: BoolArray | None = None


def require_photos(data: Path, parts: tuple[Part, ...]) -> None:
    """Raises ConfigError that names what is missing of the files that the parts need."""
    missing = [str(file) for part in parts for file in _needed(data, part) if not (data / file).is_file()]
    if missing:
        more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
        raise ConfigError(
            f"{data}: the gallery lacks {', '.join(missing[:_NAMED])}{more}; name the folder of the real data with "
            "--data, or only the parts whose data is there with --part"
        )


def _needed(data: Path, part: Part) -> list[Path]:
    folder = Path(part.folder)
    match part:
        case Part.ENGABREEN:
            names = [*ENGABREEN_PHOTOS, "dem_3m_f64.tif", "glacier_mask_3m.tif", "gcp8902.csv"]
        case Part.CANYON:
            names = [*PHOTOS.values(), "gcps.csv", *(f"22_{date}_GRID.tif" for date in SURVEYS)]
        case Part.TOWERS:
            names = [] if _tower_photos(data) else ["*.jpg"]
        case Part.MOUNTAINS:
            names = [f"images/{name}.jpg" for name in mountain_names()]
    return [folder / name for name in names]


def mountain_names() -> tuple[str, ...]:
    """Every second of the held-out test photos, which train nothing, in the order of the training file."""
    return mountain_sets().held_out["photos_test"][::MOUNTAINS_EVERY]


def mountain_sets() -> PhotoSets:
    return load_yaml(lab_config("training/mountain_photos.yaml"), PhotoSets)


def canyon_areas(date: str, shape: tuple[int, int]) -> UInt8Array:
    """Class ids (H, W) of the areas that a person named in the canyon's photo of a date, 255 elsewhere."""
    sets = load_yaml(lab_config("training/canyon_photos.yaml"), PhotoSets)
    return _resized(sets.by_hand(Path(PHOTOS[date]).stem), shape)


def read_towers(data: Path) -> list[NamedPhoto]:
    """All tower photos, in order of name. Raises ImageError where one cannot be read or its labels do not fit."""
    found = []
    for path in _tower_photos(data):
        photo, areas = read_rgb(path), path.with_name(f"{path.stem}_labels.png")
        truth = _read_ids(areas, photo.shape[:2]) if areas.is_file() else None
        found.append(NamedPhoto(path.stem, photo, truth))
    return found


def read_mountains(data: Path) -> list[NamedPhoto]:
    """The mountain photos that the rule takes. Raises ImageError as `read_towers` does."""
    folder, sets, found = data / Part.MOUNTAINS.folder, mountain_sets(), []
    for name in mountain_names():
        photo = read_rgb(folder / "images" / f"{name}.jpg")
        areas = _resized(sets.by_hand(name), photo.shape[:2]) if name in sets.boxes else None
        mask = folder / "labels" / f"{name.removesuffix('_resized')}_mask.jpg"
        mountain = _read_mask(mask, photo.shape[:2]) if mask.is_file() else None
        found.append(NamedPhoto(name.removesuffix("_resized"), photo, areas, mountain))
    return found


def read_engabreen_points(data: Path) -> ControlPoints:
    """The surveyed control points of the first photo, in the map frame; the file counts pixels from 1."""
    return read_control_points(data / Part.ENGABREEN.folder / "gcp8902.csv", ENGABREEN, first_pixel=1.0)


def read_glacier(data: Path) -> tuple[Dem, Dem]:
    """Engabreen's terrain, and on the same cells 1 where there is ice, 0 elsewhere; in the map frame."""
    folder = data / Part.ENGABREEN.folder
    names = "dem_3m_f64.tif", "glacier_mask_3m.tif"
    dem, ice = (Dem.open(folder / name).in_frame(ENGABREEN) for name in names)
    return dem, ice


def _tower_photos(data: Path) -> list[Path]:
    return sorted((data / Part.TOWERS.folder).glob("*.jpg"))


def _read_ids(path: Path, shape: tuple[int, ...]) -> UInt8Array:
    ids = read_values(path)
    if ids.shape != shape or ids.dtype != np.uint8:
        raise ImageError(f"{path}: ids of {ids.shape} {ids.dtype} do not fit their photo of {shape}: one uint8 a pixel")
    return np.ascontiguousarray(ids)


def _read_mask(path: Path, shape: tuple[int, ...]) -> BoolArray:
    grey = read_rgb(path)[..., 0]
    if grey.shape != shape:
        raise ImageError(f"{path}: a mask of {grey.shape} does not fit its photo of {shape}")
    return np.asarray(grey >= 128)


def _resized(ids: UInt8Array, shape: tuple[int, ...]) -> UInt8Array:
    return np.asarray(cv2.resize(ids, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST_EXACT), np.uint8)
