"""Writes a simulated recording as files: pictures, truth, frames.json, and the rasters of the site.

frames.json                 scenario, CRS, origin, dates; of each frame its true pose and time, what its sensors
                                `reported` of them, and file names
NNNN.png, NNNN_labels.png   the picture; class ids of every truth_step-th pixel
NNNN_truth.npz              range_surface, range_ground (slant metres, +inf sky), labels, at the same pixels
scenario.yaml               the scenario, if a kind and a seed have drawn it
dem.tif                     the DEM handed to the system: an outdated copy of the first date's ground
dem_around.tif              a coarser one of the range about the site
dem_region.tif              a coarse one to the mountains on the horizon
fuel_truth.tif              class ids on the 30 m grid at the first date (edges = 15 mod 30, 255 none)
truth/DATE/                 the site at each date; all GeoTIFFs are in the scenario's CRS
    ground.tif              the ground's own cells: bilinear between their centres, it is what is rendered
    bare_earth.tif          1 m, float32 metres: that ground sampled, which rounds edges sharper than a metre
    surface.tif             1 m, bare earth + canopy
    canopy.tif              1 m, height of shrubs and trees over bare earth (0: none; grass and stones not counted)
    class.tif               1 m, class ids
    life_form.tif           30 m, majority class id, 255 none
    fuel_code.tif           30 m, Scott and Burgan fuel model number (91 .. 204), 255 none
truth/change_A_B.tif        1 m, bits: 1 ground moved >= 0.1 m, 2 plants changed >= 0.5 m, 4 other class
truth/fuel_change_A_B.tif   30 m, bits: 1 other life form, 2 other fuel code
"""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.vision.labels import LabelSet
from ltm_lab.simulator.mitsuba_scene import SURROUNDINGS_SINK
from ltm_lab.simulator.rasters import UNKNOWN, SiteRasters, outdated_dem, regional_dem, site_change
from ltm_lab.simulator.run import SimulatedFrame, SimulatedSite
from ltm_lab.simulator.scenario import Scenario
from ltm_lab.simulator.viewpoints import Report

_COLORS = dict(enumerate(LabelSet.load().colors)) | {0: (0, 0, 0)}


def write_scenario(out: Path, scenario: Scenario) -> None:
    """`scenario.yaml`: the scenario without its defaults, for a drawn one."""
    out.mkdir(parents=True, exist_ok=True)
    values = scenario.model_dump(mode="json", exclude_defaults=True)
    (out / "scenario.yaml").write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")


def write_site(out: Path, scenario: Scenario, site: SimulatedSite, truth: SiteRasters) -> None:
    """`dem.tif`, `dem_around.tif`, `dem_region.tif` and `fuel_truth.tif` of the first date's site and its rasters."""
    out.mkdir(parents=True, exist_ok=True)
    x0, y0 = scenario.origin
    elevation, geometry = outdated_dem(site.terrain.site, scenario.dem, scenario.seed)
    write_geotiff(out / "dem.tif", elevation, geometry.translated(x0, y0, scenario.crs))
    elevation, geometry = outdated_dem(site.terrain.surroundings, scenario.dem_around, scenario.seed + 7)
    elevation -= np.float32(SURROUNDINGS_SINK)  # as it is rendered
    write_geotiff(out / "dem_around.tif", elevation, geometry.translated(x0, y0, scenario.crs))
    elevation, geometry = regional_dem(site.terrain, scenario.seed)
    write_geotiff(out / "dem_region.tif", elevation, geometry.translated(x0, y0, scenario.crs))
    write_geotiff(out / "fuel_truth.tif", truth.life_form, truth.coarse, nodata=UNKNOWN, colormap=_COLORS)


def write_truth(out: Path, date: str, scenario: Scenario, site: SimulatedSite, truth: SiteRasters) -> None:
    """`truth/DATE/`: the rasters of one date."""
    folder = out / "truth" / date
    folder.mkdir(parents=True, exist_ok=True)
    ground = site.terrain.site
    own = ground.geometry.translated(*scenario.origin, scenario.crs)
    write_geotiff(folder / "ground.tif", _to_millimetres(ground.elevation), own)
    for name in ("bare_earth", "surface", "canopy"):
        write_geotiff(folder / f"{name}.tif", _to_millimetres(getattr(truth, name)), truth.fine)
    write_geotiff(folder / "class.tif", truth.classes, truth.fine, nodata=UNKNOWN, colormap=_COLORS)
    write_geotiff(folder / "life_form.tif", truth.life_form, truth.coarse, nodata=UNKNOWN, colormap=_COLORS)
    write_geotiff(folder / "fuel_code.tif", truth.fuel_code, truth.coarse, nodata=UNKNOWN)


def _to_millimetres(heights: Float32Array) -> Float32Array:
    """What is below is noise that does not deflate."""
    return np.asarray(np.rint(heights * np.float32(1024)) / np.float32(1024), np.float32)


def write_change(out: Path, names: tuple[str, str], before: SiteRasters, after: SiteRasters) -> None:
    """`truth/change_A_B.tif` and `truth/fuel_change_A_B.tif` between the dates `names`."""
    change = site_change(before, after)
    a, b = names
    write_geotiff(out / "truth" / f"change_{a}_{b}.tif", change.fine, before.fine)
    coarse = change.life_form.astype(np.uint8) | (change.fuel_code.astype(np.uint8) << 1)
    write_geotiff(out / "truth" / f"fuel_change_{a}_{b}.tif", coarse, before.coarse)


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
        "date": shot.date,
        "stamp_ns": shot.stamp_ns,
        "camera": _camera(shot.camera),
        "truth_camera": _camera(frame.truth.camera),
        "position": [float(v) for v in shot.pose.position],
        "azimuth_deg": azimuth,
        "pitch_deg": pitch,
        "roll_deg": roll,
        "mast": shot.mast,
        "reported": _reported(shot.report),
    }


def _reported(report: Report) -> dict[str, Any]:
    azimuth, pitch, roll = report.pose.angles_deg
    return {
        "stamp_ns": report.stamp_ns,
        "received_ns": report.received_ns,
        "position": [float(v) for v in report.pose.position],
        "azimuth_deg": azimuth,
        "pitch_deg": pitch,
        "roll_deg": roll,
        "covariance": [float(v) for v in np.diag(report.covariance)],
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
        "jpeg_quality": scenario.imaging.jpeg_quality,
        "walks": [{"name": w.name, "geoid_undulation": w.geoid_undulation} for w in scenario.walks],
        "dates": [{"name": d.name, "years": d.years} for d in scenario.dates],
        "frames": sorted(entries, key=lambda e: (e["stamp_ns"], e["camera_name"])),
    }
    part = out / "frames.json.part"
    part.write_text(json.dumps(index, indent=1) + "\n", encoding="utf-8")
    part.replace(out / "frames.json")
