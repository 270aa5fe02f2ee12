"""Makes a region with many towers, and the serialised votes that their cameras send over and over in the load test."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from rclpy.serialization import serialize_message

from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.fuel.vote_columns import fitting
from ltm_core.fuel.votes import VoteCaster
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.pointcloud import votes_to_msg

NAME = "region"
_CELL = 20.0
_RELIEF = 500.0
_ROUGHNESS = -2.1
"""Exponent of amplitude over frequency."""
_MAST = 25.0
_PATCH = 240.0
_CAMERA = Camera.from_fov(960, 540, 62.0)
"""Half of 1080p a side: it sees the same cells, but for the most distant, at a quarter of the tracing."""
_COVARIANCE = np.diag([0.3**2] * 3 + [np.radians(0.2) ** 2] * 3)


@dataclass(frozen=True)
class Traffic:
    """`messages`: serialised votes by tower. `cells`, `bytes`: means of a message."""

    site: Path
    messages: dict[str, list[bytes]]
    cells: float
    bytes: float


def write_region(folder: Path, towers: int, extent: float, views: int, seed: int = 0) -> Traffic:
    """A square region of `extent` metres with its site file in `folder`, and `views` headings of each tower."""
    rng = np.random.default_rng(seed)
    dem = Dem(_terrain(rng, round(extent / _CELL)), _geometry(extent))
    dem.save(folder / "dem.tif")
    names = [f"t{number:04d}" for number in range(towers)]
    site = {
        "name": NAME,
        "crs": "EPSG:32611",
        "origin": [400_005.0, 3_800_025.0],
        "dem": {"path": "dem.tif"},
        "possible_ground": {"highest": 0.0},
        "cameras": {name: {} for name in names},
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(site), encoding="utf-8")
    config = load_site(path)
    ground = config.open_dem()
    labels = LabelSet.load()
    caster = VoteCaster(
        config.fuel_geometry(ground), ground, labels.votes_table[: len(labels)], config.fuel.max_range, config.bend
    )
    tracer = TerrainTracer(ground, config.curvature, config.refraction, config.possible_ground)
    messages: dict[str, list[bytes]] = {}
    cells = []
    for name in names:
        position = _high_place(rng, ground)
        messages[name] = []
        for view in range(views):
            pose = Pose.from_angles(position, 360.0 * view / views + rng.uniform(0, 360 / views), -5.0, 0.0)
            ranges = tracer.trace(_CAMERA, pose)
            seen = _labels_of(ranges.points(), rng)
            confidence = rng.integers(120, 256, seen.shape).astype(np.uint8)
            votes = fitting(
                caster.cast(ranges.range, _CAMERA, pose, seen, 0, name, confidence, _COVARIANCE, along_axis=False), view
            )
            cells.append(len(votes))
            messages[name].append(serialize_message(votes_to_msg(votes, labels.names)))
    size = float(np.mean([len(m) for sent in messages.values() for m in sent]))
    return Traffic(path, messages, float(np.mean(cells)), size)


def _geometry(extent: float) -> GridGeometry:
    cells = round(extent / _CELL)
    return GridGeometry(400_005.0, 3_800_025.0 + cells * _CELL, _CELL, cells, cells, "EPSG:32611")


def _terrain(rng: np.random.Generator, cells: int) -> Float32Array:
    """Mountains by spectral synthesis (Saupe, in The Science of Fractal Images, 2.6)."""
    frequency = np.hypot(np.fft.fftfreq(cells)[:, None], np.fft.rfftfreq(cells)[None])
    frequency[0, 0] = np.inf
    phases = np.exp(2j * np.pi * rng.random(frequency.shape))
    height = np.fft.irfft2(phases * frequency**_ROUGHNESS, (cells, cells))
    elevation: Float32Array = (300 + _RELIEF * (height - height.min()) / np.ptp(height)).astype(np.float32)
    return elevation


def _high_place(rng: np.random.Generator, dem: Dem) -> tuple[float, float, float]:
    """Towers stand where they see much: the highest of some places."""
    g = dem.geometry
    x = rng.uniform(g.x_min + 100, g.x_max - 100, 12)
    y = rng.uniform(g.y_min + 100, g.y_max - 100, 12)
    z = dem.elevation_at(x, y)
    best = int(np.argmax(z))
    return float(x[best]), float(y[best]), float(z[best]) + _MAST


def _labels_of(points: Float32Array, rng: np.random.Generator) -> UInt8Array:
    """Patches of covers on the ground, a tenth of the pixels mistaken."""
    with np.errstate(invalid="ignore"):
        patch = np.floor(points[..., 0] / _PATCH) * 3 + np.floor(points[..., 1] / _PATCH)
    cover = np.where(np.isfinite(patch), 1 + np.nan_to_num(patch) % 4, 0)
    wrong = rng.random(cover.shape) < 0.1
    return np.where(wrong & (cover > 0), rng.integers(1, 5, cover.shape), cover).astype(np.uint8)
