"""Makes of the frames of a simulated walk what a phone would have stored: photos, a sensor recording, and the truth."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.geometry.geodesy import SiteFrame
from ltm_lab.frames.truth_frames_io import TruthFrame, read_index, read_truth_frames
from ltm_lab.simulator.phone_photo_io import PhonePhoto, write_phone_photo
from ltm_lab.simulator.sensor_logger_io import write_sensor_logger

PHOTOS, SENSOR_LOGGER, TRUE_POSES = "photos", "sensor_logger.zip", "true_poses.csv"


def write_phone_capture(
    frames: Path, out: Path, progress: Callable[[int, int], None] = lambda done, total: None
) -> int:
    """Write the walk of a `ltm-lab simulate` folder to `out`; the number of its photos.

    `photos/IMG_0001.jpg` and so on: JPEG with EXIF. `sensor_logger.zip`: the phone's sensors on that walk as the app
    records them. `true_poses.csv`: where each photo was truly taken, as a photo list for `ltm import`. Raises
    RecordingError on a folder without frames of exactly one walk, or where photos of an earlier one lie."""
    index = read_index(frames)
    walks = {walk.name: walk for walk in index.walks}
    entries = [frame for frame in read_truth_frames(frames) if frame.camera_name in walks]
    names = {frame.camera_name for frame in entries}
    if len(names) != 1:
        raise RecordingError(
            f"{frames}/frames.json has frames of {len(names)} walks; give the scenario exactly one in `walks`"
        )
    (out / PHOTOS).mkdir(parents=True, exist_ok=True)
    if any((out / PHOTOS).iterdir()):
        raise RecordingError(f"{out / PHOTOS} is not empty: remove it, or write elsewhere")
    photos, rows = [], []
    quality, site = index.jpeg_quality, index.site_frame
    for number, entry in enumerate(entries, start=1):
        photo = _photo(entry, f"IMG_{number:04d}.jpg")
        write_phone_photo(out / PHOTOS / photo.name, photo, site, quality)
        photos.append(photo)
        rows.append(_true_row(photo.name, entry, site))
        progress(number, len(entries))
    undulation = walks[names.pop()].geoid_undulation
    write_sensor_logger(out / SENSOR_LOGGER, photos, site, quality, undulation, with_frames=False)
    with (out / TRUE_POSES).open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return len(photos)


def _photo(frame: TruthFrame, name: str) -> PhonePhoto:
    told = frame.reported
    return PhonePhoto(name, frame.photo, frame.camera, told.pose, told.stamp_ns, float(np.sqrt(told.covariance[0])))


def _true_row(name: str, frame: TruthFrame, site: SiteFrame) -> dict[str, str]:
    x, y, z = (float(v) for v in frame.pose.position)
    values = (x + site.x_origin, y + site.y_origin, z)
    names = ("azimuth_deg", "pitch_deg", "roll_deg")
    angles = {key: f"{value:.4f}" for key, value in zip(names, frame.pose.angles_deg, strict=True)}
    place = {key: f"{value:.3f}" for key, value in zip("xyz", values, strict=True)}
    return {"name": name} | place | angles | {"fx": f"{frame.camera.fx:.3f}"}
