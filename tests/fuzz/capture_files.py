"""Readers of what phones and drones record."""

from __future__ import annotations

import io
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scenes.movie_file import movie
from scenes.phone_site import STAMP, taken

from fuzz.mutations import spoil_text
from fuzz.target import Target
from ltm_core.cameras.sensor_pose import phone_camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_lab.simulator.sensor_logger_io import write_sensor_logger
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.dji import read_subtitles
from ltm_ros.recordings.importing.pictures import find_pictures
from ltm_ros.recordings.importing.sensor_logger import read_sensor_logger_json

FRAME = SiteFrame("EPSG:32611", 402_000.0, 3_787_000.0)


def _walk(folder: Path) -> list[bytes]:
    """One as it is, and one whose tables are not packed, so that spoiled bytes reach their reader."""
    write_sensor_logger(folder / "seed.zip", [taken(0, (231.0, -3.5, 1.0))], FRAME, 60, -35.4, attitude_hz=2.0)
    packed = (folder / "seed.zip").read_bytes()
    (folder / "seed.zip").unlink()
    plain = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(packed)) as old, zipfile.ZipFile(plain, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
    return [packed, plain.getvalue()]


def _json(folder: Path) -> list[bytes]:
    fix = '{"sensor":"Location","time":"1720143015250000000","latitude":"34.2","longitude":"-118.1","altitude":"1500"}'
    turn = '{"sensor":"Orientation","time":"1720143015250000000","qx":"0.7","qy":"0","qz":"0","qw":"0.7141428"}'
    return [f'[{fix},{turn},{{"sensor":"Metadata","platform":"android"}}]'.encode()]


def _read(folder: Path, name: str) -> None:
    for picture in find_pictures([folder / name], Assumptions())[0]:
        picture.read()


def _read_json(folder: Path) -> None:
    track = read_sensor_logger_json(folder / "walk.json")
    if track is not None:
        track.at(STAMP, phone_camera())


def _srt(folder: Path) -> list[bytes]:
    new = (
        '1\n00:00:00,000 --> 00:00:00,033\n<font size="28">FrameCnt: 1, DiffTime: 33ms\n2024-07-04 18:30:15.500\n'
        "[focal_len: 27.00] [dzoom_ratio: 1.00], [latitude: 34.225] [longitude: -118.06] "
        "[rel_alt: 40.0 abs_alt: 1550.0] [gb_yaw: -10.0 gb_pitch: -12.0 gb_roll: 0.5] </font>\n\n"
    )
    old = "1\n00:00:00,000 --> 00:00:01,000\nGPS(-118.060000,34.225000,19) BAROMETER:40.5\n2024.07.04 18:30:15\n\n"
    height = "1\n00:00:00,000 --> 00:00:01,000\nGPS (34.2250, -118.0600, 0.0M), H 40.50ft, DZOOM 2.000\n\n"
    return [(new + new.replace("00:00:00", "00:00:01")).encode(), old.encode(), height.encode()]


def _read_srt(folder: Path) -> None:
    found = read_subtitles(folder / "a.srt")
    found.track.at(1, np.eye(3))
    found.lens_at(0.0)


def _video(folder: Path) -> list[bytes]:
    frames = [np.full((24, 40, 3), 60 * k, np.uint8) for k in range(2)]
    plain = movie(frames, 1, datetime(2024, 7, 5, tzinfo=UTC), location="+34.2250-118.0600+1500.000/")
    return [plain, movie(frames, 1, None, turned=90)]


CAPTURE_FILES = (
    Target("sensor_logger_zip", "walk.zip", _walk, lambda folder: _read(folder, "walk.zip")),
    Target("sensor_logger_json", "walk.json", _json, _read_json),
    Target("video", "a.mp4", _video, lambda folder: _read(folder, "a.mp4")),
    Target("subtitles", "a.srt", _srt, _read_srt, spoil_text),
)
