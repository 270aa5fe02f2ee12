"""Read reconstructions of Metashape, COLMAP and OpenSfM."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree  # nosec B405 # documents with a DTD are rejected before they are parsed

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.cameras.foreign_camera import ForeignPose, earth_centred, east_north_up
from ltm_core.geometry.camera import Camera
from ltm_core.storage.config_io import read_text

LARGEST = 256 << 20
"""Maximum size of a file in bytes."""
Similarity = tuple[float, Float64Array, Float64Array]
"""Scale, rotation (3, 3) and shift (3,)."""


def read_transform(path: Path) -> Similarity:
    """Return the similarity of a text file: scale, quaternion w x y z and shift (COLMAP's model_aligner), or a matrix
    of 12 or 16 numbers. Raises PoseError."""
    values = np.array(numbers_of(read_text(path, 1 << 16, PoseError)))
    if len(values) == 8:
        return float(values[0]), Rotation.from_quat(values[[2, 3, 4, 1]]).as_matrix(), values[5:]
    if len(values) in (12, 16):
        return _similarity(values[:12].reshape(3, 4))
    raise PoseError(f"{path}: has {len(values)} numbers; give 8 (scale, quaternion, shift), 12 or 16 (a matrix)")


def _similarity(matrix: Float64Array) -> Similarity:
    scale = float(np.cbrt(np.linalg.det(matrix[:, :3])))
    return scale, matrix[:, :3] / scale, matrix[:, 3]


def numbers_of(text: str) -> list[float]:
    """Return the numbers in a text without comments."""
    text = re.sub(r"(?m)[%#].*$", "", text)
    return [float(word) for word in re.findall(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])", text)]


def metashape_poses(path: Path, text: str) -> list[ForeignPose]:
    """Return the cameras of an XML export. Its camera axes are the optical ones; pixels count from the image's
    corner, the centre from its middle."""
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
    turn = np.array(numbers_of(place.findtext("rotation", ""))).reshape(3, 3)
    shift = np.array(numbers_of(place.findtext("translation", ""))).reshape(3)
    poses = []
    for entry in chunk.iter("camera"):
        matrix = entry.findtext("transform")
        if matrix is None or entry.get("enabled") in ("0", "false"):
            continue
        at = np.array(numbers_of(matrix)).reshape(4, 4)
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


def colmap_poses(path: Path, text: str, transform: Similarity | None) -> list[ForeignPose]:
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
        turn = Rotation.from_quat([float(v) for v in (x, y, z, w)]).as_matrix()
        position, rotation = -turn.T @ [float(v) for v in (tx, ty, tz)], turn.T
        if transform is not None:
            scale, about, shift = transform
            position, rotation = scale * about @ position + shift, about @ rotation
        name = name.strip()
        poses.append(ForeignPose(name, f"{path}: image {name}", position, rotation, cameras[camera]))
    return poses


def opensfm_poses(path: Path, text: str) -> list[ForeignPose]:
    """Return the shots, world to camera, metres east, north, up of a reference; focal lengths are shares of the
    longer side."""
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
            turn = Rotation.from_rotvec(shot["rotation"]).as_matrix()
            position = earth_centred(lla, -turn.T @ np.array(shot["translation"], np.float64))
            rotation = east_north_up(lla[1], lla[0]).T @ turn.T
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
