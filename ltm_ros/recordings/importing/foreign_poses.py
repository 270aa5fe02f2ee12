"""Read poses of Metashape, COLMAP, OpenSfM, alproj, ImGRAFT, PRACTISE, Pic2Map, and lists of omega, phi, kappa."""

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree  # nosec B405 # documents with a DTD are rejected before they are parsed

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.cameras import foreign_camera as foreign
from ltm_core.cameras.foreign_camera import ForeignPose, closest_camera, omega_phi_kappa
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, matrix_of_angles, matrix_of_quaternion, matrix_of_vector
from ltm_core.storage.config_io import read_text

LARGEST = 256 << 20
"""Maximum size of a file in bytes."""
Similarity = tuple[float, Float64Array, Float64Array]
"""Scale, rotation (3, 3) and shift (3,)."""


def read_transform(path: Path) -> Similarity:
    """Return the similarity of a file: scale, quaternion w x y z, shift (COLMAP), or a matrix. Raises PoseError."""
    values = np.array(_numbers_of(read_text(path, 1 << 16, PoseError)))
    if len(values) == 8:
        return float(values[0]), matrix_of_quaternion(values[[2, 3, 4, 1]]), values[5:]
    if len(values) in (12, 16):
        matrix = values[:12].reshape(3, 4)
        scale = float(np.cbrt(np.linalg.det(matrix[:, :3])))
        return scale, matrix[:, :3] / scale, matrix[:, 3]
    raise PoseError(f"{path}: has {len(values)} numbers; give 8 (scale, quaternion, shift), 12 or 16 (a matrix)")


def _numbers_of(text: str) -> list[float]:
    """Return the numbers in a text without comments."""
    text = re.sub(r"(?m)[%#].*$", "", text)
    return [float(word) for word in re.findall(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])", text)]


def _metashape_poses(path: Path, text: str) -> list[ForeignPose]:
    """Return the cameras of an XML export. Axes are optical; the centre counts from the image's middle."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise PoseError(f"{path}: XML with a document type is not read")
    try:
        root = ElementTree.fromstring(text)  # nosec B314 # without a DTD, see above
    except ElementTree.ParseError as error:
        raise PoseError(f"{path}: is not XML ({error})") from error
    chunk = root if root.tag == "chunk" else root.find(".//chunk")
    if chunk is None:
        raise PoseError(f"{path}: has no <chunk>; export the cameras of Metashape as XML")
    cameras = {sensor.get("id"): _metashape_camera(sensor, str(path)) for sensor in chunk.iter("sensor")}
    places = (chunk.find(path) for path in ("transform", "components/component/transform"))
    place = next((found for found in places if found is not None), None)
    if place is None or place.find("rotation") is None:
        raise PoseError(f"{path}: the chunk is not on the map (no <transform>); align it with its GPS or markers first")
    scale = float(place.findtext("scale", "1"))
    turn = np.array(_numbers_of(place.findtext("rotation", ""))).reshape(3, 3)
    shift = np.array(_numbers_of(place.findtext("translation", ""))).reshape(3)
    poses = []
    for entry in chunk.iter("camera"):
        matrix = entry.findtext("transform")
        if matrix is None or entry.get("enabled") in ("0", "false"):
            continue
        at = np.array(_numbers_of(matrix)).reshape(4, 4)
        name = entry.get("label") or ""
        position, rotation = scale * turn @ at[:3, 3] + shift, turn @ at[:3, :3]
        where = f"{path}: camera {name}"
        poses.append(ForeignPose(name, where, position, rotation, cameras.get(entry.get("sensor_id"))))
    return poses


def _metashape_camera(sensor: ElementTree.Element, place: str) -> Camera | None:
    found = sensor.findall("calibration")
    size = sensor.find("resolution")
    if not found or size is None:
        return None
    calibration = next((c for c in found if c.get("class") == "adjusted"), found[-1])
    if calibration.get("type", sensor.get("type")) != "frame":
        raise PoseError(f"{place}: sensor {sensor.get('label')} is no frame camera; only those are imported")
    values = {e.tag: float(e.text or 0) for e in calibration if e.tag not in ("resolution", "covariance")}
    width, height = int(size.get("width", 0)), int(size.get("height", 0))
    f = values.get("f") or values["fx"]
    if values.get("k4") or abs(values.get("b2", 0.0)) > 0.5:
        raise PoseError(f"{place}: sensor {sensor.get('label')} has k4 or skew (b2); calibrate it without them")
    # Its first tangential term is that along x, which is p2 of OpenCV.
    lens = tuple(values.get(key, 0.0) for key in ("k1", "k2", "p2", "p1", "k3"))
    cx, cy = (width - 1) / 2 + values.get("cx", 0.0), (height - 1) / 2 + values.get("cy", 0.0)
    fy = values.get("fy", f)
    return Camera(width, height, f + values.get("b1", 0.0), fy, cx, cy, lens)  # type: ignore[arg-type]


_COLMAP = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
}
"""Parameters of COLMAP's camera models."""


def _colmap_poses(path: Path, text: str, transform: Similarity | None) -> list[ForeignPose]:
    """Return the images of images.txt, whose rotations are world to camera; the first pixel's centre is 0.5."""
    cameras: dict[str, Camera] = {}
    place = path.with_name("cameras.txt")
    lines = read_text(place, LARGEST, PoseError).splitlines()
    for line in (line for line in lines if line.strip() and not line.startswith("#")):
        number, model, width, height, *values = line.split()
        if model not in _COLMAP:
            raise PoseError(f"{place}: camera {number} has the model {model}; known are {', '.join(_COLMAP)}")
        p = dict(zip(_COLMAP[model].split(), map(float, values), strict=True))
        if any(p.get(key) for key in ("k4", "k5", "k6")):
            raise PoseError(f"{place}: camera {number} has k4 to k6; calibrate it as OPENCV")
        fx = p.get("fx", p.get("f", 0.0))
        lens = tuple(p.get(key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3"))
        size, centre = (int(width), int(height)), (p["cx"] - 0.5, p["cy"] - 0.5)
        cameras[number] = Camera(*size, fx, p.get("fy", fx), *centre, lens)  # type: ignore[arg-type]
    poses = []
    # Each image has a second line, of its points, which may be empty.
    rows = "\n".join(line for line in text.splitlines() if not line.startswith("#")).rstrip().split("\n")
    for line in rows[::2] if rows[0] else ():
        _, w, x, y, z, tx, ty, tz, camera, name = line.split(maxsplit=9)
        turn = matrix_of_quaternion([float(v) for v in (x, y, z, w)])
        position, rotation = -turn.T @ [float(v) for v in (tx, ty, tz)], turn.T
        if transform is not None:
            scale, about, shift = transform
            position, rotation = scale * about @ position + shift, about @ rotation
        name = name.strip()
        poses.append(ForeignPose(name, f"{path}: image {name}", position, rotation, cameras[camera]))
    return poses


def _opensfm_poses(path: Path, text: str) -> list[ForeignPose]:
    """Return the shots, world to camera, metres from a reference; focal lengths are shares of the longer side."""
    parts = json.loads(text)
    beside = path.with_name("reference_lla.json")
    reference: Any = parts[0].get("reference_lla")
    if beside.is_file():
        reference = json.loads(read_text(beside, 1 << 16, PoseError))
    if reference is None:
        raise PoseError(f"{path}: has no reference_lla, and {beside.name} is not beside it; copy it from the project")
    lla = np.array([float(reference[key]) for key in ("latitude", "longitude", "altitude")])
    poses = []
    for part in parts:
        cameras = {key: _opensfm_camera(value, f"{path}: camera {key}") for key, value in part["cameras"].items()}
        for name, shot in part["shots"].items():
            turn = matrix_of_vector(shot["rotation"])
            position = foreign.earth_centred(lla, -turn.T @ np.array(shot["translation"], np.float64))
            rotation = foreign.east_north_up(lla[1], lla[0]).T @ turn.T
            place = f"{path}: shot {name}"
            poses.append(ForeignPose(name, place, position, rotation, cameras[shot["camera"]], True))
    return poses


def _opensfm_camera(values: dict[str, Any], place: str) -> Camera:
    kind = values.get("projection_type", "perspective")
    if kind not in ("perspective", "brown", "simple_radial", "radial"):
        raise PoseError(f"{place} has the projection {kind}; perspective and brown are imported")
    width, height = int(values["width"]), int(values["height"])
    size = max(width, height)
    fx = float(values.get("focal_x", values.get("focal", 0.0))) * size
    fy = float(values["focal_y"]) * size if "focal_y" in values else fx
    lens = tuple(float(values.get(key, 0.0)) for key in ("k1", "k2", "p1", "p2", "k3"))
    cx, cy = (float(values.get(key, 0.0)) * size for key in ("c_x", "c_y"))
    return Camera(width, height, fx, fy, (width - 1) / 2 + cx, (height - 1) / 2 + cy, lens)  # type: ignore[arg-type]


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
        ("Metashape", head.startswith("<"), lambda: _metashape_poses(path, text)),
        ("COLMAP", path.name == "images.txt", lambda: _colmap_poses(path, text, transform)),
        ("OpenSfM", head.startswith("["), lambda: _opensfm_poses(path, text)),
        ("alproj", head.startswith("{"), lambda: _alproj(path, text)),
        ("PRACTISE", "cam_foc" in text, lambda: _practise(path, text, size)),
        ("Pic2Map", "Pose estimation parameters" in text or "X position" in text, lambda: _pic2map(path, text, size)),
        ("ImGRAFT", len(_numbers_of(text)) == 20, lambda: _imgraft(path, text)),
        ("omega, phi, kappa", True, lambda: _omega_phi_kappa(path, text, camera)),
    ]
    tool, read = next((tool, read) for tool, fits, read in readers if fits)
    try:
        poses = read()
    except (LookupError, ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise PoseError(f"{path}: is not a readable file of {tool} ({type(error).__name__}: {error})") from error
    if not poses:
        raise PoseError(f"{path}: contains no pose ({tool})")
    return tool, poses


def _alproj(path: Path, text: str) -> list[ForeignPose]:
    """Return one or several poses, the latter by the photos' names. Pan, tilt and roll are in degrees."""
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
    turn = matrix_of_angles("XYZ", [-(tilt + math.pi / 2), -roll, pan])
    position = np.array([float(p[key]) for key in "xyz"])
    return ForeignPose(name, place, position, (foreign.UPWARD @ turn).T, camera)


def _imgraft(path: Path, text: str) -> list[ForeignPose]:
    """Return `fullmodel`: place, rows, columns, yaw (0 is east), pitch, roll, f, c, k1 to k6, p1, p2; pixels from 1."""
    v = np.array(_numbers_of(text))
    angles, (fx, fy, cx, cy), k, p = v[5:8], v[8:12], v[12:18], v[18:20]
    start = Camera(int(v[4]), int(v[3]), fx, fy, cx - 1, cy - 1)

    def turned(a: Float64Array) -> Float64Array:
        return np.asarray(matrix_of_angles("ZYX", a)[:, [1, 2, 0]] * [-1, -1, 1], np.float64)

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
        return _numbers_of(found[-1])

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
        return matrix_of_angles("ZXZ", np.add(a, [0.0, math.pi, 0.0]))

    angles = np.array([values[key] for key in ("heading", "tilt", "swing")])
    lens = Camera(width, height, f, f, width / 2 - 0.5, height / 2 - 0.5)
    position = np.array([-x, y, z])
    return [ForeignPose(path.stem, str(path), position, turned(angles), lens, angles=angles, turned=turned)]


def _stated(size: tuple[int, int] | None, path: Path, tool: str) -> tuple[int, int]:
    if size is None:
        raise PoseError(f"{path}: {tool} states no image size; give --size WIDTHxHEIGHT or --photos")
    return size


def _omega_phi_kappa(path: Path, text: str, camera: Camera | None) -> list[ForeignPose]:
    """Return the poses of lines of label, X, Y, Z, omega, phi, kappa; the header names the unit, else degrees."""
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
        rotation = omega_phi_kappa(values[3:] * foreign.UNITS[unit])
        poses.append(
            ForeignPose(words[0], place, values[:3], rotation, camera, angles=values[3:], turned=omega_phi_kappa)
        )
    return poses
