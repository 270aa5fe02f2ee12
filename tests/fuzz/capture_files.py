"""Readers of what phones and drones record."""

import io
import zipfile
from pathlib import Path

from scenes.phone_site import taken

from fuzz.target import Target
from ltm_core.geometry.geodesy import SiteFrame
from ltm_lab.simulator.sensor_logger_io import write_sensor_logger
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.pictures import find_pictures

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


def _read(folder: Path, name: str) -> None:
    for picture in find_pictures([folder / name], Assumptions())[0]:
        picture.read()


CAPTURE_FILES = (Target("sensor_logger_zip", "walk.zip", _walk, lambda folder: _read(folder, "walk.zip")),)
