"""A simulated recording as files: pictures, truth, frames.json, and the rasters of the site."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ltm_core.errors import ImageError
from ltm_core.grid import GridGeometry
from ltm_core.raster_io import write_geotiff
from ltm_core.simulator.outdated import outdated_dem
from ltm_core.simulator.run import SimulatedFrame, SimulatedSite
from ltm_core.simulator.scenario import Scenario
from ltm_core.simulator.truth import fuel_truth

_FUEL_RESOLUTION = 30.0  # m
_FUEL_COLORS = {0: (0, 0, 0), 1: (222, 205, 95), 2: (196, 120, 45), 3: (30, 115, 55), 4: (165, 150, 140)}


def write_site(out: Path, scenario: Scenario, site: SimulatedSite) -> None:
    """`dem.tif`, the outdated DEM that the system gets, and `fuel_truth.tif`, class ids on the 30 m grid (edges =
    15 mod 30, 255 none)."""
    out.mkdir(parents=True, exist_ok=True)
    x0, y0 = scenario.origin
    elevation, geometry = outdated_dem(site.terrain.site, scenario.dem_resolution, scenario.dem_sigma, scenario.seed)
    write_geotiff(out / "dem.tif", elevation, geometry.translated(x0, y0, scenario.crs))
    x_min, y_min, x_max, y_max = site.terrain.site.geometry.bounds
    bounds = (x_min + x0, y_min + y0, x_max + x0, y_max + y0)
    fuel_grid = GridGeometry.snapped(bounds, _FUEL_RESOLUTION, 15.0, scenario.crs)
    write_geotiff(
        out / "fuel_truth.tif",
        fuel_truth(site.cover, fuel_grid, (x0, y0)),
        fuel_grid,
        nodata=255,
        colormap=_FUEL_COLORS,
    )


def write_frame(out: Path, number: int, frame: SimulatedFrame) -> dict[str, Any]:
    """`NNNN.png`, `NNNN_labels.png` and `NNNN_truth.npz` (range_surface, range_ground, labels); returns the
    frame's entry in frames.json.

    The picture is put in place last and whole, so that a reader that waits for it finds everything. Raises
    ImageError where it cannot write.
    """
    stem = f"{number:04d}"
    np.savez_compressed(
        out / f"{stem}_truth.npz",
        range_surface=frame.truth.range_surface,
        range_ground=frame.truth.range_ground,
        labels=frame.truth.labels,
    )
    _write_png(out / f"{stem}_labels.png", frame.truth.labels)
    _write_png(out / f"{stem}.png", cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
    shot = frame.shot
    azimuth, pitch, roll = shot.pose.angles_deg
    return {
        "image": f"{stem}.png",
        "truth": f"{stem}_truth.npz",
        "labels": f"{stem}_labels.png",
        "camera_name": shot.camera_name,
        "stamp_ns": shot.stamp_ns,
        "camera": _camera(shot.camera),
        "truth_camera": _camera(frame.truth.camera),
        "position": [float(v) for v in shot.pose.position],
        "azimuth_deg": azimuth,
        "pitch_deg": pitch,
        "roll_deg": roll,
        "mast": shot.mast,
    }


def _camera(camera: Any) -> dict[str, Any]:
    return {k: getattr(camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy", "distortion")}


def _write_png(path: Path, image: Any) -> None:
    ok, data = cv2.imencode(".png", image)
    if not ok:
        raise ImageError(f"{path}: cannot encode an image of {image.shape} {image.dtype} as PNG")
    part = path.with_suffix(".part")
    part.write_bytes(data.tobytes())
    part.replace(path)


def write_index(out: Path, scenario: Scenario, entries: list[dict[str, Any]]) -> None:
    """`frames.json`: the scenario's frame of reference, and its frames in time order."""
    index = {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "crs": scenario.crs,
        "origin": list(scenario.origin),
        "truth_step": scenario.truth_step,
        "curvature": scenario.curvature,
        "frames": sorted(entries, key=lambda e: (e["stamp_ns"], e["camera_name"])),
    }
    part = out / "frames.json.part"
    part.write_text(json.dumps(index, indent=1) + "\n", encoding="utf-8")
    part.replace(out / "frames.json")
