"""Readers of what phones and drones record."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

from scenes.phone_site import STAMP, taken

from fuzz.target import Target
from ltm_core.device_attitude import phone_camera
from ltm_core.geodesy import SiteFrame
from ltm_core.simulator.sensor_logger_io import write_sensor_logger
from ltm_ros.importer.assumptions import Assumptions
from ltm_ros.importer.pictures import find_pictures
from ltm_ros.importer.sensor_logger import read_sensor_logger_json

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
    for picture in find_pictures([folder / name], Assumptions()):
        picture.read()


def _read_json(folder: Path) -> None:
    track = read_sensor_logger_json(folder / "walk.json")
    if track is not None:
        track.at(STAMP, phone_camera())


CAPTURE_FILES = (
    Target("sensor_logger_zip", "walk.zip", _walk, lambda folder: _read(folder, "walk.zip"), weight=2.0),
    Target("sensor_logger_json", "walk.json", _json, _read_json),
)
