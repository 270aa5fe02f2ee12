"""Measure the peak memory of whole commands on a large DEM, each in a process of its own."""

import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from runpy import run_module

import cv2
import numpy as np
import yaml

from ltm_core.base.errors import LtmError
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.vision.manifest import DEFAULT_DEPTH_MODEL
from ltm_lab.bench.measure import in_own_process, peak_mb
from ltm_lab.bench.mountains import ridged_terrain

CORNER = (300_000.0, 3_800_000.0)
"""Lower left corner of the terrain in `CRS`, metres."""
CRS = "EPSG:32611"
CAMERA = Camera.from_fov(1920, 1080, 60.0)
AZIMUTHS_DEG = {"west": 300.0, "east": 60.0}
PITCH_DEG = -5.0
MAST_M = 25.0


def commands(folder: Path) -> dict[str, tuple[str, ...]]:
    """Return the arguments of `ltm` by name, in an order in which each finds its input, for the site in `folder`."""
    site, bag = str(folder / "site.yaml"), str(folder / "bag")
    one = ("--dem", str(folder / "dem.tif"), "--pose", str(folder / "pose.yaml"))
    photos = (str(folder / "photos"), "--poses", str(folder / "poses.csv"))
    points = (str(folder / "points.csv"), "--guess", str(folder / "pose.yaml"))
    store = str(folder / "state/fuel_map.ltm")
    return {
        "check, with an image": ("check", site, "--out", str(folder / "check.png")),
        "trace": ("trace", *one, "--out", str(folder / "trace")),
        "trace, over a photo": (
            "trace",
            *one,
            "--out",
            str(folder / "over"),
            "--image",
            str(folder / "photos/east.jpg"),
        ),
        "viewshed": ("viewshed", "--site", site, "--out", str(folder / "viewshed.tif")),
        "pose": ("pose", "points", *points, "--dem", str(folder / "dem.tif"), "--out", str(folder / "fitted.yaml")),
        "import": ("import", *photos, "--site", site, "--out", bag),
        "replay --offline": ("replay", bag, "--site", site, "--offline", "--out", str(folder / "replay")),
        "export of a landscape": ("export", store, "--site", site, "--out", str(folder / "landscape.tif")),
        "export of an image": ("export", store, "--site", site, "--out", str(folder / "map.png")),
    }


def run_command(arguments: tuple[str, ...]) -> float:
    """Return the peak memory of `ltm` with these arguments, MB. Raises LtmError if the command fails."""
    return in_own_process(_peak_of, arguments)


def _peak_of(arguments: tuple[str, ...]) -> float:
    sys.argv = ["ltm", *arguments]
    output = StringIO()
    try:
        with redirect_stdout(output), redirect_stderr(output):
            run_module("ltm_ros.cli.main", run_name="__main__")  # as `python -m` does
    except SystemExit as ended:
        if ended.code:
            raise LtmError(f"ltm {' '.join(arguments)} failed: {output.getvalue().strip()[-1000:]}") from ended
    return peak_mb()


def make_site(folder: Path, size: int, camera: Camera = CAMERA) -> None:
    """Write a DEM of `size` x `size` cells of 1 m, a site with two cameras in its middle, their photos, and control
    points into `folder`."""
    dem = ridged_terrain(size)
    named = Dem(dem.elevation, GridGeometry(CORNER[0], CORNER[1] + size, 1.0, size, size, CRS))
    named.save(folder / "dem.tif")
    x, y = CORNER[0] + size / 2, CORNER[1] + size / 2
    ground = float(named.elevation_at(x, y))
    place = {"x": x, "y": y, "height_above_ground": MAST_M}
    calibration = {"width": camera.width, "height": camera.height, "fx": camera.fx}
    cameras = {
        name: {"calibration": calibration, "pose": {**place, "azimuth_deg": azimuth, "pitch_deg": PITCH_DEG}}
        for name, azimuth in AZIMUTHS_DEG.items()
    }
    _write(
        folder / "site.yaml",
        {
            "name": "large",
            "crs": CRS,
            "origin": list(CORNER),
            "dem": {"path": "dem.tif"},
            "depth_model": DEFAULT_DEPTH_MODEL,
            "cameras": cameras,
            "nodes": {"fuel_map": {"folder": str(folder / "state")}},
        },
    )
    east = AZIMUTHS_DEG["east"]
    _write(
        folder / "pose.yaml",
        {
            "pose": {"x": x, "y": y, "height_above_ground": MAST_M, "azimuth_deg": east, "pitch_deg": PITCH_DEG},
            "calibration": calibration,
        },
    )
    (folder / "photos").mkdir()
    rows = ["name,camera,x,y,height_above_ground,azimuth_deg,pitch_deg,fx,stamp"]
    for number, (name, azimuth) in enumerate(AZIMUTHS_DEG.items()):
        cv2.imwrite(str(folder / f"photos/{name}.jpg"), _photo(camera, number))
        rows.append(
            f"{name}.jpg,{name},{x},{y},{MAST_M},{azimuth},{PITCH_DEG},{camera.fx},2026-07-01T12:00:{number:02d}Z"
        )
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    _write_points(folder / "points.csv", named, camera, Pose.from_angles((x, y, ground + MAST_M), east, PITCH_DEG))


def _photo(camera: Camera, seed: int) -> UInt8Array:
    """Return sky above mottled green, which a network classifies as a landscape."""
    rng = np.random.default_rng(seed)
    photo = np.full((camera.height, camera.width, 3), (235, 206, 165), np.uint8)
    half = camera.height // 2
    mottles = cv2.resize(rng.integers(40, 130, (half // 4, camera.width // 4)).astype(np.uint8), (camera.width, half))
    photo[-half:] = mottles[..., None] * np.array([0.5, 1.0, 0.7])
    return photo


def _write_points(path: Path, dem: Dem, camera: Camera, pose: Pose) -> None:
    """Write points of the ground with their pixels in the east camera, hidden or not."""
    rng = np.random.default_rng(0)
    distance = rng.uniform(200.0, 0.4 * dem.geometry.width * dem.geometry.resolution, 1000)
    turn = np.deg2rad(AZIMUTHS_DEG["east"] + rng.uniform(-25.0, 25.0, 1000))
    x, y = pose.position[0] + distance * np.sin(turn), pose.position[1] + distance * np.cos(turn)
    places = np.stack([x, y, dem.elevation_at(x, y)], axis=-1)
    pixels = camera.project((places - pose.position) @ pose.rotation)
    inside = ((pixels > 20) & (pixels < np.array([camera.width, camera.height]) - 20)).all(axis=1)
    rows = ["id,x,y,z,u,v"]
    for number in np.flatnonzero(inside)[:10]:
        rows.append(",".join([f"p{number}", *(f"{value:.3f}" for value in (*places[number], *pixels[number]))]))
    path.write_text("\n".join(rows) + "\n")


def _write(path: Path, content: object) -> None:
    path.write_text(yaml.safe_dump(content, sort_keys=False))
