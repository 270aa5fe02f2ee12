"""Makes of the frames of a simulated walk what a phone would have stored: photos, a sensor recording, and the truth."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.phone_photo_io import PhonePhoto, write_phone_photo
from ltm_lab.simulator.sensor_logger_io import write_sensor_logger

PHOTOS, SENSOR_LOGGER, TRUE_POSES = "photos", "sensor_logger.zip", "true_poses.csv"


def write_phone_capture(
    frames: Path, out: Path, progress: Callable[[int, int], None] = lambda done, total: None
) -> int:
    """Write the walk of a `ltm-lab simulate` folder to `out`; the number of its photos.

    `photos/IMG_0001.jpg` and so on: JPEG with EXIF. `sensor_logger.zip`: the same walk as the app records it.
    `true_poses.csv`: where each photo was truly taken, as a photo list for `ltm import`.
    Raises RecordingError on a folder without frames of exactly one walk, or where photos of an earlier one lie.
    """
    index_file = frames / "frames.json"
    try:
        index = json.loads(index_file.read_text(encoding="utf-8"))
        walks = {str(walk["name"]): walk for walk in index["walks"]}
        entries = [entry for entry in index["frames"] if entry["camera_name"] in walks]
        frame = SiteFrame(index["crs"], *(float(v) for v in index["origin"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordingError(
            f"{index_file}: no index of simulated frames ({error}); `ltm-lab simulate` writes one"
        ) from error
    names = {entry["camera_name"] for entry in entries}
    if len(names) != 1:
        raise RecordingError(
            f"{index_file}: has frames of {len(names)} walks, a capture is of one; give the scenario one `walks`"
        )
    (out / PHOTOS).mkdir(parents=True, exist_ok=True)
    if any((out / PHOTOS).iterdir()):
        raise RecordingError(f"{out / PHOTOS} is not empty: remove it, or write elsewhere")
    photos, rows = [], []
    quality = int(index.get("jpeg_quality", 78))
    for number, entry in enumerate(entries, start=1):
        photo = _photo(frames, entry, f"IMG_{number:04d}.jpg")
        write_phone_photo(out / PHOTOS / photo.name, photo, frame, quality)
        photos.append(photo)
        rows.append(_true_row(photo.name, entry, frame))
        progress(number, len(entries))
    undulation = float(walks[names.pop()]["geoid_undulation"])
    write_sensor_logger(out / SENSOR_LOGGER, photos, frame, quality, undulation)
    with (out / TRUE_POSES).open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return len(photos)


def _photo(folder: Path, entry: dict[str, Any], name: str) -> PhonePhoto:
    image = cv2.imread(str(folder / entry["image"]), cv2.IMREAD_COLOR)
    if image is None:
        raise RecordingError(f"{folder / entry['image']}: the frame's picture is missing or broken; render it again")
    told = entry["reported"]
    camera = Camera(**entry["camera"] | {"distortion": tuple(entry["camera"]["distortion"])})
    pose = Pose.from_angles(told["position"], told["azimuth_deg"], told["pitch_deg"], told["roll_deg"])
    return PhonePhoto(
        name,
        np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8),
        camera,
        pose,
        int(told["stamp_ns"]),
        float(np.sqrt(told["covariance"][0])),
    )


def _true_row(name: str, entry: dict[str, Any], frame: SiteFrame) -> dict[str, str]:
    x, y, z = entry["position"]
    values = (x + frame.x_origin, y + frame.y_origin, z)
    angles = {key: f"{entry[key]:.4f}" for key in ("azimuth_deg", "pitch_deg", "roll_deg")}
    place = {key: f"{value:.3f}" for key, value in zip("xyz", values, strict=True)}
    return {"name": name} | place | angles | {"fx": f"{entry['camera']['fx']:.3f}"}
