"""What cameras answer: pictures in a folder, streams of parts, lists of cameras."""

import json
from pathlib import Path

from scenes.source_under_test import Sourced, TurnedClock, settings
from scenes.timed_picture import exif_of, jpeg, scene

from fuzz.mutations import spoil_text
from fuzz.target import Target
from ltm_ros.cameras.protocols.exposure import ExposureClock
from ltm_ros.cameras.protocols.files import entry_of, reading_of, time_of
from ltm_ros.cameras.protocols.http_pictures import PartSplitter
from ltm_ros.cameras.protocols.picture import Timing, stated_number

_LIST = settings(kind="camera_list", url="http://127.0.0.1/all.json", image="http://127.0.0.1/{id}.jpg", id="north")


def _pictures(folder: Path) -> list[bytes]:
    whole = scene(64, 48)
    return [jpeg(whole), jpeg(whole, "CMYK"), jpeg(whole, exif=exif_of("2026:08:01 12:00:00", "25", "-07:00"))]


def _ask_folder(folder: Path) -> None:
    """A source catches what is wrong with a picture; what it raises is a fault."""
    clock = TurnedClock((folder / "a.jpg").stat().st_mtime)
    sourced = Sourced(settings(kind="folder", path=str(folder), complete_within=5), clock)
    for _ in range(4):
        clock.turn(max(sourced.source.step(), 2.0))


def _stream(folder: Path) -> list[bytes]:
    body = jpeg(scene(32, 24))
    stated = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%b\r\n" % (len(body), body)
    counted = [
        b"--frame\r\nX-Timestamp: %b\r\n\r\n%b\r\n--frame--\r\n" % (at, body) for at in (b"12.5", b"nan", b"-inf")
    ]
    return [stated * 3, *counted]


def _split(folder: Path) -> None:
    parts, data, clock = PartSplitter(b"--frame", 100_000), (folder / "x").read_bytes(), ExposureClock()
    for begin in range(0, len(data), 700):
        for head, _ in parts.feed(data[begin : begin + 700]):
            timing = Timing(5000.0, oldest=0.3, stream=stated_number(head.get("x-timestamp")))
            exposure = clock.estimate(timing, 1_790_000_000.0)
            assert 0 < exposure.uncertainty < 60, exposure


def _lists(folder: Path) -> list[bytes]:
    entry = {"id": "north", "last_frame_ts": 1_790_000_000, "az_current": 12.5, "tilt_current": -1, "zoom_current": 4}
    forms = [entry], {"cameras": [entry]}, {"north": entry}, {"features": [{"properties": entry}]}
    return [json.dumps(form).encode() for form in forms]


def _listed(folder: Path) -> None:
    entry = entry_of((folder / "x.json").read_bytes(), _LIST)
    reading_of(entry, _LIST)
    time_of(entry.get("last_frame_ts"))


CAMERA_ANSWERS = (
    Target("camera_picture", "a.jpg", _pictures, _ask_folder),
    Target("camera_stream", "x", _stream, _split),
    Target("camera_list", "x.json", _lists, _listed, spoil_text),
)
