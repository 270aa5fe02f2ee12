"""Read the cameras of a new site: `NAME=LON,LAT,key=value,...`, CSV, GeoJSON, and ALERTCalifornia's list."""

import csv
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.errors import ConfigError, ImageError
from ltm_core.base.strict_model import StrictModel
from ltm_core.cameras.plausibility import AzimuthDeg, PitchDeg, RollDeg
from ltm_core.site.sections import CameraConfig
from ltm_core.storage.config_io import checked, read_text
from ltm_core.storage.disk_io import is_folder
from ltm_core.storage.image_io import read_rgb
from ltm_ros.site_setup.vertical import Datum, correction, named_datum

_LARGEST_LIST = 32 << 20
_NAMES: Mapping[str, str] = {
    "name": "name|camera|id|title",
    "lon": "lon|lng|long|longitude|x",
    "lat": "lat|latitude|y",
    "height": "height|height_m|height_above_ground|mast|mast_height|agl",
    "z": "z|elevation|elev|altitude|alt|elevation_m",
    "datum": "datum|vertical_datum|vertical_crs",
    "azimuth": "azimuth|azimuth_deg|az|bearing|heading|direction",
    "pitch": "pitch|pitch_deg|tilt",
    "roll": "roll|roll_deg",
    "hfov": "hfov|hfov_deg|fov|fov_deg",
    "size": "size|resolution",
    "photos": "photos|folder",
}
"""Names of columns and properties by key."""
_LIST_URL = "https://cameras.alertcalifornia.org/public-camera-data/all_cameras-v3.json"
_IMAGE_URL = "https://cameras.alertcalifornia.org/public-camera-data/{id}/latest-frame.jpg"
_WEEK = 604_800.0


class CameraValues(StrictModel):
    """What a user states of a camera."""

    name: str
    lon: float = Field(ge=-180, le=180)
    lat: float = Field(ge=-90, le=90)
    height: float = Field(10.0, ge=0, le=500)
    """Height above the ground in metres; ignored if z is given."""
    z: float | None = None
    """Height in metres above `datum`."""
    datum: str = ""
    """Vertical datum of z: navd88, egm2008, egm96, ellipsoidal or a CRS; empty: the site's."""
    azimuth: AzimuthDeg | None = None
    """Azimuth of the viewing direction in degrees, clockwise from true north."""
    pitch: PitchDeg = 0.0
    roll: RollDeg = 0.0
    hfov: float | None = Field(None, gt=0, lt=180)
    size: str = Field("1920x1080", pattern=r"^\d{2,5}x\d{2,5}$")
    """Width and height of the images in pixels."""
    photos: Path | None = None
    """Folder into which the camera writes its images."""
    listed: str = ""
    """Identifier in the list of ALERTCalifornia, which has the direction of each image."""

    @model_validator(mode="after")
    def _datum_of_z(self) -> "CameraValues":
        if self.datum and self.z is None:
            raise ValueError("datum needs z")
        return self

    @property
    def ros_name(self) -> str:
        """Return the name in the form of topic names."""
        plain = re.sub(r"[^a-z0-9]+", "_", self.name.lower()).strip("_")
        return plain if plain[:1].isalpha() else f"camera_{plain}".rstrip("_")


def parse_camera(text: str) -> CameraValues:
    """Return a camera of `NAME=LON,LAT,key=value,...`. Raises ConfigError."""
    name, _, rest = text.partition("=")
    parts = [part.strip() for part in rest.split(",")]
    if len(parts) < 2 or not name.strip():
        raise ConfigError(f"--camera {text}: give NAME=LON,LAT,height=20,azimuth=214,hfov=54")
    given: dict[str, Any] = {"name": name.strip(), "lon": parts[0], "lat": parts[1]}
    for part in parts[2:]:
        key, sign, value = (word.strip() for word in part.partition("="))
        if not sign or key in given:
            raise ConfigError(f"--camera {text}: {part!r} is no key=value or repeats a key; write height=20")
        given[key] = value
    return _with_size(checked(CameraValues, given, f"--camera {text}"))


def read_cameras(path: Path) -> tuple[list[CameraValues], list[str]]:
    """Return the cameras of a CSV file, a GeoJSON file or ALERTCalifornia's list, and remarks about those left out.

    Raises ConfigError: not such a file, columns that are missing, values that are not possible."""
    text = read_text(path, _LARGEST_LIST, ConfigError, "utf-8-sig")
    rows = list(_features(text, path) if text.lstrip()[:1] in ("{", "[") else _lines(text, path))
    cameras, unplaced = [], 0
    for place, row in rows:
        if row.get("lon") in (None, "") or row.get("lat") in (None, ""):
            unplaced += 1
            continue
        stated = {key: value for key, value in row.items() if value not in (None, "")}
        cameras.append(_with_size(checked(CameraValues, stated, place)))
    remarks = [f"{path.name}: {unplaced} of {len(rows)} cameras have no position and are left out"] if unplaced else []
    if not cameras:
        raise ConfigError(f"{path}: has no camera with a position; give a name, lon and lat for each")
    return cameras, remarks


def _lines(text: str, path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    first = text.partition("\n")[0]
    lines = csv.reader(text.splitlines(), delimiter=max(",;\t", key=first.count))
    header = next(lines, [])
    keys = _keys(header)
    lacking = [name for name in ("name", "lon", "lat") if name not in keys.values()]
    if lacking:
        raise ConfigError(
            f"{path}: no column for {', '.join(lacking)} among {', '.join(header)[:200] or 'none'}; name the columns "
            f"{', '.join(_NAMES)}"
        )
    for number, line in enumerate(lines, 2):
        if any(line):
            cells = dict(zip(header, (cell.strip() for cell in line), strict=False))
            yield f"{path}, line {number}", {key: cells[name] for name, key in keys.items() if name in cells}


def _features(text: str, path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    try:
        content = json.loads(text)
        features = content["features"] if isinstance(content, dict) else content
        for number, feature in enumerate(features, 1):
            about = dict(feature.get("properties") or {})
            point = (feature.get("geometry") or {}).get("coordinates") or (None, None)
            keys = _keys(about)
            row = {key: about[name] for name, key in keys.items() if key not in ("lon", "lat", "z")}
            turning = {"id", "az_current"} <= about.keys()
            if turning:
                row = {"name": about.get("name") or about["id"], "listed": str(about["id"])}
            elif "name" not in row:
                row["name"] = f"camera {number}"
            yield f"{path}, camera {number}", {**row, "name": str(row["name"]), "lon": point[0], "lat": point[1]}
    except (ValueError, TypeError, KeyError, AttributeError, IndexError, RecursionError) as error:
        raise ConfigError(f"{path}: not GeoJSON with points, nor a list of cameras ({error})") from error


def _keys(names: Iterable[str]) -> dict[str, str]:
    """Return the key of each known name; the first one counts."""
    plain = {name.strip().lower(): name for name in reversed(list(names))}
    known = {key: [plain[s] for s in spellings.split("|") if s in plain] for key, spellings in _NAMES.items()}
    return {found[0]: key for key, found in known.items() if found}


def _with_size(camera: CameraValues) -> CameraValues:
    """Return the camera with the size of its first photo. Raises ConfigError if its folder has none."""
    if camera.photos is None:
        return camera
    folder = camera.photos.expanduser().absolute()
    photos = sorted(p for p in folder.glob("*") if p.suffix.lower() in (".jpg", ".jpeg")) if is_folder(folder) else []
    if not photos:
        raise ConfigError(f"camera {camera.name}: no *.jpg in {folder}; give the folder of its photos")
    try:
        height, width = read_rgb(photos[0]).shape[:2]
    except ImageError as error:
        raise ConfigError(f"{error}; remove it") from error
    pattern = f"*{photos[0].suffix}"
    return camera.model_copy(update={"photos": folder / pattern, "size": f"{width}x{height}"})


def check_cameras(cameras: Iterable[CameraValues], there: Mapping[str, CameraConfig]) -> None:
    """Check cameras before anything is fetched. `there`: those of the site. Raises ConfigError for a camera whose name
    is taken, or whose viewing direction or field of view is missing."""
    taken = {name for name, config in there.items() if config != CameraConfig()}
    for camera in cameras:
        if camera.ros_name in taken:
            raise ConfigError(f"camera {camera.ros_name} exists already; give each camera its own name")
        taken.add(camera.ros_name)
        for key, value, example in (("azimuth", camera.azimuth, 214), ("hfov", camera.hfov, 54)):
            if value is None and not camera.listed:
                raise ConfigError(f"camera {camera.name}: {key} is missing; give {key}={example} (degrees)")


def section(camera: CameraValues, datum: Datum | None) -> tuple[dict[str, Any], list[str]]:
    """Return a camera's section of the site file, and remarks. `datum`: of the site.

    Raises ConfigError if the datum of its height cannot be compared with the site's, MissingGridError if it cannot be
    converted."""
    width, height = (int(part) for part in camera.size.split("x"))
    place: dict[str, Any] = {"lon": camera.lon, "lat": camera.lat}
    remarks: list[str] = []
    if camera.z is None:
        place["height_above_ground"] = camera.height
    else:
        lift = 0.0
        if camera.datum:
            if datum is None:
                raise ConfigError(
                    f"camera {camera.name}: z is above {camera.datum}, but the DEM states no vertical datum; state the "
                    "DEM's (rio edit-info --crs EPSG:CODE+5703), or give height above the ground"
                )
            lift = correction(named_datum(camera.datum), datum, np.array([camera.lon]), np.array([camera.lat])).item()
        place["z"] = round(camera.z + lift, 3)
    if camera.listed:
        place |= {"azimuth_deg": 0.0, "azimuth_ref": "true"}
        source = {"kind": "camera_list", "url": _LIST_URL, "id": camera.listed, "image": _IMAGE_URL}
        if round(camera.lon, 2) == camera.lon and round(camera.lat, 2) == camera.lat:
            remarks.append(f"{camera.ros_name}: its position is rounded to 0.01 degrees (1 km); correct lon and lat")
        return {"source": source, "mount": {**place, "lens": {"width": width, "height": height}}}, remarks
    place |= {"azimuth_deg": camera.azimuth, "azimuth_ref": "true", "pitch_deg": camera.pitch}
    if camera.roll:
        place["roll_deg"] = camera.roll
    entry: dict[str, Any] = {}
    if camera.photos is not None:
        path, pattern = str(camera.photos.parent), camera.photos.name
        entry["source"] = {"kind": "folder", "path": path, "pattern": pattern, "oldest": _WEEK}
    entry["calibration"] = {"width": width, "height": height, "hfov_deg": camera.hfov}
    entry["pose"] = place
    return entry, remarks
