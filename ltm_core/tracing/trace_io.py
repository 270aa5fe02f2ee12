"""Read the pose file of a photo, and write the files of `ltm trace`."""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field

from ltm_core.base.errors import ConfigError, ImageError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import UInt8Array, UInt32Array
from ltm_core.cameras.camera_config import CalibrationConfig, PlacedPose, PoseConfig
from ltm_core.cameras.plausibility import doubt_of_height, doubt_of_radians
from ltm_core.geometry.camera import Camera, strips
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.storage.config_io import load_yaml
from ltm_core.tracing.possible_ground import PossibleGround

_ANGLES = ("azimuth_deg", "pitch_deg", "roll_deg")


class PoseFile(StrictModel):
    """Pose file: one image's `pose` and `calibration`, as for a camera in a site file."""

    pose: PlacedPose
    calibration: CalibrationConfig
    curvature: bool = True
    refraction: float = Field(0.13, ge=0, lt=1)
    possible_ground: PossibleGround = PossibleGround()
    """Maximum height of ground where the DEM is unknown."""


class PictureConfig(PoseFile):
    """One image: its camera's pose and calibration."""

    pose: PoseConfig


@dataclass(frozen=True)
class PictureSetup:
    """Image ready to be traced, in a map frame whose origin is near its camera."""

    dem: Dem
    frame: SiteFrame
    camera: Camera
    pose: Pose
    doubts: tuple[str, ...] = ()
    """Warnings about poses that may be in another unit or of another place."""


def load_picture_config(path: Path | str) -> PictureConfig:
    """Read a pose file. Raises ConfigError naming the file and each wrong key."""
    return load_yaml(path, PictureConfig)


def set_up_picture(config: PictureConfig, dem: Dem) -> PictureSetup:
    """Place the camera of `config` on `dem`. Raises PoseError for a camera under the ground, or above unknown ground;
    ConfigError for an invalid CRS."""
    frame, local = near_frame(config, dem)
    pose = config.pose.pose(local, frame)
    x, y, z = (float(v) for v in pose.position)
    ground = float(local.elevation_at(x, y))
    beside = None
    if ground != ground:
        covered = dem.levels[-1].geometry
        beside = (
            f"camera at {config.pose.described(frame)}, outside the DEM's known ground ({covered.described()} in "
            f"{frame.crs}): check position and crs"
        )
    doubts = (doubt_of_radians([config.pose.azimuth_deg]), doubt_of_height(z, ground), beside)
    camera = config.calibration.camera()
    return PictureSetup(local, frame, camera, pose, tuple(doubt for doubt in doubts if doubt))


def near_frame(config: PoseFile, dem: Dem) -> tuple[SiteFrame, Dem]:
    """Return a map frame in the DEM's CRS whose origin is near the camera of `config`, and the DEM in it."""
    crs = dem.geometry.crs
    if crs is None:
        raise ConfigError("the DEM must be in a CRS to place a camera on it")
    x, y = config.pose.xy(SiteFrame(crs)) or (0.0, 0.0)
    frame = SiteFrame(crs, round(x / 1000) * 1000.0, round(y / 1000) * 1000.0)
    return frame, dem.in_frame(frame)


def read_photo(path: Path | str, camera: Camera) -> UInt8Array:
    """Return a photo upright as its EXIF says, (H, W, 3) uint8 RGB. Raises ImageError: not readable, not the camera's
    size."""
    from ltm_core.storage.image_io import read_picture, read_rgb, stated_size

    photo = read_rgb(Path(path))
    if photo.shape[:2] != (camera.height, camera.width):
        width, height = stated_size(read_picture(Path(path)), str(path))
        turned = f", upright as EXIF turns its {width} x {height}," if photo.shape[1] != width else ""
        raise ImageError(
            f"{path}: photo of {photo.shape[1]} x {photo.shape[0]} pixels{turned} but the pose file's camera has "
            f"{camera.width} x {camera.height}; give the calibration of "
            + ("the upright image" if turned else "this image size")
        )
    return photo


def cell_counts(traced: RangeImage) -> UInt32Array:
    """Return the number of pixels that see each DEM cell, (H, W) of the raster."""
    if traced.geometry is None:
        raise ImageError("this range image has no raster, so it has no cells")
    counts = np.zeros(traced.geometry.shape, np.uint32)
    for rows in strips(len(traced.range)):
        x, y, _ = traced.points()[rows][np.isfinite(traced.range[rows])].T
        row, col = traced.geometry.cell_of(x, y)
        inside = traced.geometry.contains(row, col)
        # Not by bincount: over a large raster that takes twice the DEM's own memory.
        np.add.at(counts.reshape(-1), (row * counts.shape[1] + col)[inside], np.uint32(1))
    return counts


def write_trace(out: Path, traced: RangeImage, frame: SiteFrame, counts: UInt32Array | None = None) -> list[Path]:
    """Write a traced image as GeoTIFFs into the folder `out`; return their paths.

    `range.tif`, `depth.tif` (along the optical axis), `horizontal.tif` (the paper's depth): float32 metres, one value a
    pixel of the image, +inf sky, NaN unknown. `alignment.tif`: x, y in the CRS and z, float64 (float32 would round
    northings to half a metre). These four lie in image space; camera, pose and CRS stand in their tags.
    `seen.tif`: pixels a DEM cell, uint32, on the DEM's own grid: `counts` (of `cell_counts`, for those who have them).
    """
    out.mkdir(parents=True, exist_ok=True)
    tags = _tags(traced, frame)
    origin = np.array([frame.x_origin, frame.y_origin, 0.0])
    layers: dict[str, dict[str, NDArray[np.generic]]] = {
        "range": {"range along the ray, m": traced.range},
        "depth": {"depth along the optical axis, m": traced.depth()},
        "horizontal": {"horizontal distance, m": traced.horizontal()},
        "alignment": {name: traced.points()[..., k] + origin[k] for k, name in enumerate(("x, m", "y, m", "z, m"))},
    }
    written = [out / f"{name}.tif" for name in layers]
    for path, bands in zip(written, layers.values(), strict=True):
        _write_image_raster(path, bands, tags)
    if traced.geometry is not None:
        written.append(out / "seen.tif")
        geometry = traced.geometry.translated(frame.x_origin, frame.y_origin, crs=frame.crs)
        write_geotiff(written[-1], cell_counts(traced) if counts is None else counts, geometry, nodata=0)
    return written


def _tags(traced: RangeImage, frame: SiteFrame) -> dict[str, str]:
    (x, y, z), angles = (float(v) for v in traced.pose.position), traced.pose.angles_deg
    keys = ("width", "height", "fx", "fy", "cx", "cy", "distortion")
    pose = {"position": [x + frame.x_origin, y + frame.y_origin, z], **dict(zip(_ANGLES, angles, strict=True))}
    return {
        "LTM_CRS": frame.crs,
        "LTM_CAMERA": json.dumps({key: getattr(traced.camera, key) for key in keys}),
        "LTM_POSE": json.dumps(pose),
        "LTM_BEND": repr(traced.bend),
    }


def _write_image_raster(path: Path, bands: dict[str, NDArray[np.generic]], tags: dict[str, str]) -> None:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    first = next(iter(bands.values()))
    height, width = first.shape
    profile = {"driver": "GTiff", "width": width, "height": height, "count": len(bands), "dtype": first.dtype}
    # Level 1 takes a third of the time, for a few percent more bytes.
    profile |= {"nodata": np.nan, "compress": "deflate", "zlevel": 1, "predictor": 3}
    profile |= {"interleave": "band", "blockysize": 16}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)  # it lies in image space
        with rasterio.open(path, "w", **profile) as sink:
            for band, (description, values) in enumerate(bands.items(), start=1):
                sink.write(values, band)
                sink.set_band_description(band, description)
            sink.update_tags(**tags)


class GuessConfig(PoseFile):
    """Known values of a camera before its pose is found: a pose file with optional angles. The position is held, or
    starts the search; without `azimuth_deg` all directions are searched."""


def write_pose_file(
    path: Path | str,
    camera: Camera,
    pose: Pose,
    sigmas: Mapping[str, float],
    rays: tuple[bool, float],
    frame: SiteFrame,
    notes: Sequence[str],
) -> None:
    """Write a pose file that `ltm trace` reads. `sigmas`: by the keys of a pose file; `rays`:
    curvature and refraction; `notes`: comments at its top."""
    x, y, z = (float(v) for v in pose.position)
    angles = {key: round(angle, 6) for key, angle in zip(_ANGLES, pose.angles_deg, strict=True)}
    lens = {key: round(float(getattr(camera, key)), 4) for key in ("fx", "fy")} | {"cx": camera.cx, "cy": camera.cy}
    lens |= dict(zip(("k1", "k2", "p1", "p2", "k3"), map(float, camera.distortion), strict=True))
    place = {"x": round(x + frame.x_origin, 4), "y": round(y + frame.y_origin, 4), "z": round(z, 4), "crs": frame.crs}
    content = {
        "pose": place | angles | dict(sigmas),
        "calibration": {"width": camera.width, "height": camera.height, **lens},
        **dict(zip(("curvature", "refraction"), rays, strict=True)),
    }
    head = "".join(f"# {note}\n" for note in notes)
    Path(path).write_text(head + yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
