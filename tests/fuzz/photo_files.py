"""Readers of photos, with their EXIF."""

import contextlib
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from fuzz.target import Target
from ltm_core.base.errors import CameraError
from ltm_core.geometry.camera import Camera
from ltm_core.tracing import trace_io
from ltm_core.vision.masks import MaskMaker
from ltm_ros.recordings.importing.intrinsics import intrinsics
from ltm_ros.recordings.importing.photo import read_photo


def _exif() -> Image.Exif:
    exif = Image.Exif()
    exif[0x0112], exif[0x0132] = 6, "2024:05:06 07:08:09"
    exif.get_ifd(0x8769).update(
        {0x9003: "2024:05:06 07:08:09", 0x9011: "+02:00", 0x920A: 6.86, 0xA405: 26, 0xA404: 1.5, 0x9291: "123"}
    )
    exif.get_ifd(0x8769).update({0xA002: 4000, 0xA003: 3000, 0xA20E: 600.0, 0xA20F: 600.0, 0xA210: 3, 0x927C: b"abcd"})
    gps = {1: "N", 2: (34.0, 12.0, 30.5), 3: "W", 4: (117.0, 5.0, 1.25), 5: b"\0", 6: 912.5, 7: (7.0, 8.0, 9.0)}
    exif.get_ifd(0x8825).update(gps | {16: "M", 17: 123.5, 29: "2024:05:06"})
    return exif


def _photos(kind: str, **options: object) -> Callable[[Path], list[bytes]]:
    def made(folder: Path) -> list[bytes]:
        from pillow_heif import register_heif_opener

        register_heif_opener()
        pixels = np.random.default_rng(3).integers(0, 255, (6, 9, 3), np.uint8).repeat(8, 0).repeat(8, 1)
        files = []
        for exif in (Image.Exif(), _exif()):
            file = io.BytesIO()
            Image.fromarray(pixels).save(file, kind, exif=exif.tobytes(), **options)
            files.append(file.getvalue())
        return files

    return made


def _read_photo(folder: Path, name: str) -> None:
    photo = read_photo(folder / name)
    with contextlib.suppress(CameraError):
        intrinsics(photo.lens, photo.width, photo.height, name)
    trace_io.read_photo(folder / name, Camera.from_fov(photo.width, photo.height, 60.0))


def _photo(suffix: str, seeds: Callable[[Path], list[bytes]]) -> Target:
    return Target(f"photo_{suffix}", f"a.{suffix}", seeds, lambda folder: _read_photo(folder, f"a.{suffix}"))


_XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
    b'drone-dji:GpsLatitude="34.225" drone-dji:GpsLongitude="-118.06" drone-dji:AbsoluteAltitude="+1561.50" '
    b'drone-dji:RelativeAltitude="+60.0" drone-dji:GimbalYawDegree="-128.30" drone-dji:GimbalPitchDegree="-21.50" '
    b'drone-dji:GimbalRollDegree="+0.40" drone-dji:RtkStdLon="0.03" drone-dji:RtkStdLat="0.05" '
    b'drone-dji:DewarpData="2018-09-04;55.5,55.4,1,2,-0.2,0.1,0,0,0" GPano:ProjectionType="perspective" '
    b'drone-dji:CalibratedFocalLength="55.5" drone-dji:CalibratedOpticalCenterX="36.0"/></x:xmpmeta>'
)


def _masks(folder: Path) -> list[bytes]:
    files = []
    for mode in ("L", "1"):
        file = io.BytesIO()
        Image.fromarray((np.arange(48 * 70).reshape(48, 70) % 9 < 3).astype(np.uint8) * 255).convert(mode).save(
            file, "PNG"
        )
        files.append(file.getvalue())
    return files


PHOTO_FILES = (
    _photo("jpg", _photos("JPEG", quality=90)),
    _photo("png", _photos("PNG")),
    Target("mask_png", "m.png", _masks, lambda folder: MaskMaker(folder / "m.png", "cameras.a.mask")),
    _photo("heic", _photos("HEIF")),
    Target("photo_dji", "a.jpg", _photos("JPEG", quality=90, xmp=_XMP), lambda folder: _read_photo(folder, "a.jpg")),
    Target(
        "photo_progressive", "a.jpg", _photos("JPEG", progressive=True), lambda folder: _read_photo(folder, "a.jpg")
    ),
)
