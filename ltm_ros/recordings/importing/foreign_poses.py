"""Read poses of Metashape, COLMAP, OpenSfM, alproj, ImGRAFT, PRACTISE, Pic2Map, and lists of omega, phi, kappa."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.cameras.foreign_camera import UNITS, UPWARD, ForeignPose, closest_camera, omega_phi_kappa
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.storage.config_io import read_text
from ltm_ros.recordings.importing.reconstructed_poses import (
    LARGEST,
    Similarity,
    colmap_poses,
    metashape_poses,
    numbers_of,
    opensfm_poses,
)


def read_foreign_poses(
    path: Path, size: tuple[int, int] | None = None, camera: Camera | None = None, transform: Similarity | None = None
) -> tuple[str, list[ForeignPose]]:
    """Return the tool whose file this is, by its content, and its poses.

    `size`: width and height of formats that do not state them. `camera`: of formats that state no lens. `transform`: of
    a reconstruction that is not on the map. Raises PoseError that names file and entry."""
    if path.is_dir():
        found = [path / name for name in ("images.txt", "reconstruction.json") if (path / name).is_file()]
        if not found:
            raise PoseError(f"{path}: contains neither images.txt (COLMAP) nor reconstruction.json (OpenSfM)")
        path = found[0]
    text = read_text(path, LARGEST, PoseError, "utf-8-sig")
    head = text.lstrip()[:4000]
    readers: list[tuple[str, bool, Callable[[], list[ForeignPose]]]] = [
        ("Metashape", head.startswith("<"), lambda: metashape_poses(path, text)),
        ("COLMAP", path.name == "images.txt", lambda: colmap_poses(path, text, transform)),
        ("OpenSfM", head.startswith("["), lambda: opensfm_poses(path, text)),
        ("alproj", head.startswith("{"), lambda: _alproj(path, text)),
        ("PRACTISE", "cam_foc" in text, lambda: _practise(path, text, size)),
        ("Pic2Map", "Pose estimation parameters" in text or "X position" in text, lambda: _pic2map(path, text, size)),
        ("ImGRAFT", len(numbers_of(text)) == 20, lambda: _imgraft(path, text)),
        ("omega, phi, kappa", True, lambda: _omega_phi_kappa(path, text, camera)),
    ]
    tool, read = next((tool, read) for tool, fits, read in readers if fits)
    try:
        poses = read()
    except (KeyError, ValueError, TypeError, IndexError, AttributeError, OverflowError) as error:
        raise PoseError(f"{path}: is not a readable file of {tool} ({type(error).__name__}: {error})") from error
    if not poses:
        raise PoseError(f"{path}: contains no pose ({tool})")
    return tool, poses


def _alproj(path: Path, text: str) -> list[ForeignPose]:
    """One set of parameters, or several by the photos' names. Pan from north, tilt up, roll to the right, degrees."""
    content = json.loads(text)
    many = {path.stem: content} if "pan" in content else content
    return [_alproj_pose(name, values, f"{path}: {name}") for name, values in many.items()]


_ALPROJ_TERMS = ("a1", "a2", "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "s1", "s2", "s3", "s4")


def _alproj_pose(name: str, p: dict[str, Any], place: str) -> ForeignPose:
    if p.get("model") == "fisheye":
        raise PoseError(f"{place} is a fisheye; only its pinhole model is imported")
    width, height = int(p["w"]), int(p["h"])
    f = width / 2 / math.tan(math.radians(float(p["fov"])) / 2)
    cx, cy = (float(p[key] if p.get(key) is not None else side / 2) for key, side in (("cx", width), ("cy", height)))
    # Its image is mirrored, and then its columns.
    start = Camera(width, height, f, f, width - cx, cy)
    terms = {key: float(p.get(key) or 0.0) for key in _ALPROJ_TERMS}
    camera = start
    if any(terms.values()):
        middle = np.array([cx, cy])

        def project(rays: Float64Array) -> Float64Array:
            x, y = ((start.project(rays) - middle) / middle).T
            r = x * x + y * y
            t = terms
            over, under = t["k1"] * r + t["k2"] * r**2 + t["k3"] * r**3, t["k4"] * r + t["k5"] * r**2 + t["k6"] * r**3
            u = x * (1 + over) / (1 + under) + 2 * t["p1"] * x * y + t["p2"] * (r + 2 * x * x) + t["s1"] * r
            v = y * (1 + t["a1"] + over) / (1 + t["a2"] + under) + t["p1"] * (r + 2 * y * y) + 2 * t["p2"] * x * y
            out = np.column_stack([u + t["s2"] * r**2, v + t["s3"] * r + t["s4"] * r**2])
            return np.asarray(out * middle + middle, np.float64)

        camera = closest_camera(start, project, place)
    pan, tilt, roll = (math.radians(float(p[key])) for key in ("pan", "tilt", "roll"))
    turn = Rotation.from_euler("XYZ", [-(tilt + math.pi / 2), -roll, pan])
    position = np.array([float(p[key]) for key in "xyz"])
    return ForeignPose(name, place, position, (UPWARD @ turn.as_matrix()).T, camera)


def _imgraft(path: Path, text: str) -> list[ForeignPose]:
    """`fullmodel` of its camera class: place, rows, columns, yaw (0 is east), pitch, roll, f, c, k1 to k6, p1, p2. Its
    pixels count from 1."""
    v = np.array(numbers_of(text))
    angles, (fx, fy, cx, cy), k, p = v[5:8], v[8:12], v[12:18], v[18:20]
    start = Camera(int(v[4]), int(v[3]), fx, fy, cx - 1, cy - 1)

    def turned(a: Float64Array) -> Float64Array:
        return np.asarray(Rotation.from_euler("ZYX", a).as_matrix()[:, [1, 2, 0]] * [-1, -1, 1], np.float64)

    def project(rays: Float64Array) -> Float64Array:
        x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
        r = x * x + y * y
        a = (1 + k[0] * r + k[1] * r**2 + k[2] * r**3) / (1 + k[3] * r + k[4] * r**2 + k[5] * r**3)
        u = a * x + 2 * p[0] * x * y + p[1] * (r + 2 * x * x)
        w = a * y + 2 * p[0] * x * y + p[1] * (r + 2 * y * y)
        return np.column_stack([start.fx * u + start.cx, start.fy * w + start.cy])

    camera = closest_camera(start, project, str(path)) if k.any() or p.any() else start
    return [ForeignPose(path.stem, str(path), v[:3], turned(angles), camera, angles=angles, turned=turned)]


def _practise(path: Path, text: str, size: tuple[int, int] | None) -> list[ForeignPose]:
    """Input file: camera and target (east, north), their heights above the DEM, roll (deg), lens and sensor (m)."""
    text = re.sub(r"(?m)%.*$", "", text)

    def values(name: str) -> list[float]:
        found = re.findall(rf"(?m)^\s*{name}\s*=\s*([^;\n]+)", text)
        if not found:
            raise PoseError(f"{path}: {name.replace(chr(92), '')} is missing")
        return numbers_of(found[-1])

    width, height = _stated(size, path, "PRACTISE")
    at, target, off = values(r"cam\(:,1\)"), values(r"cam\(:,2\)"), values("cam_off")
    f, high, wide = values("cam_foc")[0], values("cam_hei")[0], values("cam_wid")[0]
    lens = Camera(width, height, f / wide * width, f / high * height, (width - 1) / 2, (height - 1) / 2)
    east, north = target[0] - at[0], target[1] - at[1]
    # The pitch follows from the DEM under both, see `ForeignPose.pose`.
    pose = Pose.from_angles((0, 0, 0), math.degrees(math.atan2(east, north)), 0.0, values("cam_rol")[0])
    position = np.array([*at[:2], off[0]])
    aim = np.array([*target[:2], off[1]])
    return [ForeignPose(path.stem, str(path), position, pose.rotation, lens, target=aim)]


def _pic2map(path: Path, text: str, size: tuple[int, int] | None) -> list[ForeignPose]:
    """Report of its pose dialog; its first axis points west, and its centre is that of the photo."""
    width, height = _stated(size, path, "Pic2Map")
    values = {}
    for name, value in re.findall(r"(?m)^\s*([\w ]+?(?: \[\w+\])?), (?:Free|Fixed|Apriori)\s*:\s*([-+.\deE]+)", text):
        values[name.partition(" [")[0].lower().split()[0]] = float(value)
    x, y, z, f = (values[key] for key in ("x", "y", "z", "focal"))

    def turned(a: Float64Array) -> Float64Array:
        return np.asarray(Rotation.from_euler("ZXZ", np.add(a, [0.0, math.pi, 0.0])).as_matrix(), np.float64)

    angles = np.array([values[key] for key in ("heading", "tilt", "swing")])
    lens = Camera(width, height, f, f, width / 2 - 0.5, height / 2 - 0.5)
    position = np.array([-x, y, z])
    return [ForeignPose(path.stem, str(path), position, turned(angles), lens, angles=angles, turned=turned)]


def _stated(size: tuple[int, int] | None, path: Path, tool: str) -> tuple[int, int]:
    if size is None:
        raise PoseError(f"{path}: {tool} states no image size; give --size WIDTHxHEIGHT or --photos")
    return size


def _omega_phi_kappa(path: Path, text: str, camera: Camera | None) -> list[ForeignPose]:
    """Lines of label, X, Y, Z, omega, phi, kappa, and more columns that are not read; degrees, unless the header names
    another unit."""
    head = " ".join(line for line in text.splitlines()[:5] if re.match(r"\W*[A-Za-z#]", line)).lower()
    unit = next((name for name in ("gon", "radians", "degrees") if name in head or f"[{name[:3]}]" in head), "degrees")
    poses: list[ForeignPose] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = re.split(r"[\s,;]+", line.strip())
        if line.startswith("#") or len(words) < 7:
            continue
        try:
            values = np.array([float(word) for word in words[1:7]])
        except ValueError:
            if poses:
                raise PoseError(f"{path}, line {number}: X, Y, Z, omega, phi, kappa must be numbers") from None
            continue  # its header
        place = f"{path}, line {number}"
        rotation = omega_phi_kappa(values[3:] * UNITS[unit])
        poses.append(
            ForeignPose(words[0], place, values[:3], rotation, camera, angles=values[3:], turned=omega_phi_kappa)
        )
    return poses
