import math
from typing import Any

import pytest
from PIL.Image import Exif
from PIL.TiffImagePlugin import IFDRational

from ltm_core.base.errors import CameraError
from ltm_ros.recordings.importing.exif import xmp_values
from ltm_ros.recordings.importing.intrinsics import LensFacts, intrinsics, lens_of_photo

FULL_FRAME = math.hypot(36, 24)
PHOTO, INTEROPERABILITY = 0x8769, 0xA005
APPLE, MAKER_NOTE = {0x10F: "Apple"}, {0x927C: b"\1\2\3\4"}


def size(width: int, height: int) -> dict[int, Any]:
    return {0xA002: width, 0xA003: height}


def canon(focal_mm: float, sensor_mm: float, width: int, height: int) -> dict[int, Any]:
    """What a Canon writes, which states no 35 mm equivalent."""
    plane = width / sensor_mm * 25.4
    return MAKER_NOTE | size(width, height) | {0x920A: focal_mm, 0xA20E: plane, 0xA20F: plane, 0xA210: 2}


def read(
    width: int,
    height: int,
    photo: dict[int, Any],
    main: dict[int, Any] | None = None,
    related: tuple[int, int] | None = None,
    xmp: str = "",
    **given: float,
) -> Any:
    exif = Exif()
    exif.update(main or {})
    exif.get_ifd(PHOTO).update(photo)
    if related is not None:
        exif.get_ifd(PHOTO)[INTEROPERABILITY] = {0x1001: related[0], 0x1002: related[1]}
    again = Exif()
    again.load(exif.tobytes())
    return intrinsics(lens_of_photo(again, xmp_values(xmp), width, height), width, height, "a.jpg", **given)


def fov_deg(width: int, height: int, *facts: Any, **given: Any) -> float:
    """Return the field of view along the long side, in degrees."""
    return math.degrees(2 * math.atan(max(width, height) / 2 / read(width, height, *facts, **given).fx))


@pytest.mark.parametrize(
    ("width", "height", "facts", "fov"),
    [
        (4032, 3024, {0xA405: 26}, 67.3),  # iPhone 11 Pro: the diagonal, not the long side, is that of 36 x 24 mm
        (3024, 4032, {0xA405: 26, **size(4032, 3024)}, 67.3),
        (1008, 756, {0xA405: 26, **size(4032, 3024)}, 67.3),
        (4032, 3024, {0xA405: 13}, 106.2),  # ultra-wide
        (2688, 1520, {0xA405: 28, 0xA404: IFDRational(0, 0)}, 67.8),  # HTC One
        (3024, 4032, {0xA405: 0, 0x920A: 4.31}, None),
        (4288, 2848, {0xA405: 420, 0x920A: 280.0}, 4.9),  # Nikon with a teleconverter: outside the limits
        (3264, 3264, {0xA405: 8, 0x920A: 0.8}, 124.8),  # Kodak PIXPRO SP360
        (4032, 3024, {0xA405: 1}, 173.4),
        (4032, 3024, {0xA405: 11113}, 0.2),
        (100, 75, {0xA405: 26, **size(0, 0)}, 67.3),
    ],
)
def test_35_mm_equivalents(width: int, height: int, facts: dict[int, Any], fov: float | None) -> None:
    if fov is None or not 5 <= fov <= 120:
        with pytest.raises(CameraError, match="--focal-35mm" if fov is None else f"{fov:.1f} deg"):
            fov_deg(width, height, facts)
    else:
        assert fov_deg(width, height, facts) == pytest.approx(fov, abs=0.05)


@pytest.mark.parametrize(
    ("width", "height", "facts", "related", "fov"),
    [
        (3888, 2592, canon(34.0, 22.2, 3888, 2592), None, 36.2),  # EOS 1000D
        (2592, 3888, canon(34.0, 22.2, 3888, 2592), None, 36.2),
        (1152, 768, canon(33.0, 23.0, 5184, 3456), None, 38.4),  # EOS 600D, resized, with the recorded size
        (640, 480, canon(21.0, 7.11, 2272, 1704) | size(640, 480), (2272, 1704), 19.2),  # PowerShot G2, resized
        (2048, 1536, canon(5.8, 3.59, 2048, 1536) | {0xA404: 1.59375}, None, 34.4),  # A720: includes the digital zoom
        (2272, 1704, canon(21.3125, 2.60, 2272, 1704) | {0xA404: 2.7307}, None, 7.0),  # PowerShot S40
        (4272, 2848, canon(30.0, 22.3, 4272, 2848) | {0xA405: 48}, None, 40.8),
    ],
)
def test_focal_planes(
    width: int, height: int, facts: dict[int, Any], related: tuple[int, int] | None, fov: float
) -> None:
    assert fov_deg(width, height, facts, None, related) == pytest.approx(fov, abs=0.1)


@pytest.mark.parametrize(
    ("width", "height", "facts", "values"),
    [
        (100, 68, {**canon(135.0, 22.25, 3888, 2592), **size(100, 68)}, "0.2 deg"),  # EOS 40D, a thumbnail of GIMP
        (640, 480, canon(5.7, 1.65, 640, 480), "16.5 deg"),  # FinePix A303, resized by its viewer
        (1772, 1181, {**canon(28.0, 13.07, 1772, 1181), 0x927C: b""}, "26.3 deg"),  # EOS D60, resized by Photoshop
        (2659, 1773, {0x920A: 200.0, 0xA20E: 3512.2, 0xA210: 2}, "5.5 deg"),  # EOS-1D Mark III, exported by Lightroom
        (1296, 864, {**canon(50.0, 5.6, 1296, 864), 0xA405: 80}, "6.4 deg.*25.4 deg"),
        (3504, 2336, canon(17.0, 30.84, 3504, 2336), "84.4 deg"),  # EOS 20D states a sensor that does not exist
        (3504, 2336, {**canon(17.0, 22.5, 3504, 2336), 0xA20E: 2886.36}, "84.4 deg.*67.0 deg"),
        (3064, 2379, {0xA405: 42, **size(3872, 2592)}, "3872 x 2592"),  # Nikon D60, cropped
        (2566, 3313, {0xA405: 26, **size(4032, 3024)}, "4032 x 3024"),  # iPhone, cropped HEIC
        (4608, 1976, {0xA405: 26}, "4608 x 1976"),
        (4032, 3024, {0xA405: 26, 0xA401: 6}, "CustomRendered 6"),
        (5000, 3333, {0xA405: 15, 0xA434: "EF8-15mm f/4L FISHEYE USM"}, "fisheye"),
        (4000, 3000, {0xA405: 26, 0xA404: 2.0, 0x920A: 6.3}, "67.3 or 36.8 deg"),  # whether it includes the zoom?
    ],
)
def test_uncertain_focal_lengths_are_rejected_with_their_values(
    width: int, height: int, facts: dict[int, Any], values: str
) -> None:
    with pytest.raises(CameraError, match=values):
        read(width, height, {tag: value for tag, value in facts.items() if value != b""})


def test_a_focal_length_that_underflows_is_none() -> None:
    with pytest.raises(CameraError, match="does not give the focal length"):
        intrinsics(LensFacts(focal_mm=1e-200, plane=(1e-200, 1e-200)), 4032, 3024, "a.jpg")


@pytest.mark.parametrize(
    ("facts", "main", "fov"),
    [
        ({0xA405: 57, 0x920A: 4.15, 0xA404: 1.971}, APPLE, 33.8),  # iPhone 6
        ({0xA405: 34, 0x920A: 5.7, 0xA404: 1.3}, APPLE, 53.9),
        ({0xA405: 208, 0x920A: 4.2, 0xA404: 8.0}, {}, 9.5),  # without it, the sensor would be 0.7 mm wide
        ({0xA405: 28, 0x920A: 4.25, 0xA404: 1.06}, {}, 63.4),
        # The focal plane shows that the equivalent does not include the zoom.
        ({**canon(9.0, 8.8 / 2, 4032, 3024), 0xA405: 35, 0xA404: 2.0}, {}, 27.5),
    ],
)
def test_digital_zoom(facts: dict[int, Any], main: dict[int, Any], fov: float) -> None:
    assert fov_deg(4032, 3024, facts, main) == pytest.approx(fov, abs=0.1)


def test_the_calibration_of_a_drone_follows_the_size() -> None:
    """Phantom 4 RTK: offsets of the principal point are from the middle."""
    data = "2018-09-04;3666.6,3664.4,-8.5,12.0,-0.27,0.11,0.0008,-0.0002,-0.03"
    xmp = f'<rdf:Description drone-dji:DewarpData="{data}" drone-dji:DewarpFlag="0"/>'
    facts = {0xA405: 24, **size(5472, 3648)}
    whole, half = (read(w, h, facts, xmp=xmp) for w, h in ((5472, 3648), (2736, 1824)))
    assert (whole.fx, whole.fy, whole.cx, whole.cy) == (3666.6, 3664.4, 2735.5 - 8.5, 1823.5 + 12.0)
    lenses = [(one.k1, one.k2, one.p1, one.p2, one.k3) for one in (whole, half)]
    assert lenses == 2 * [(-0.27, 0.11, 0.0008, -0.0002, -0.03)]
    assert (half.fx, half.cx, half.cy) == (1833.3, (2727.5 / 2) - 0.5, 1836.0 / 2 - 0.5)
    assert read(5472, 3648, facts, xmp=xmp.replace('Flag="0"', 'Flag="1"')).k1 == 0
    assert read(1824, 2736, facts, xmp=xmp).cx is None


def test_what_the_user_states_replaces_what_is_unknown() -> None:
    assert read(4000, 3000, {}, focal_35mm=27.0).fx == pytest.approx(27 / FULL_FRAME * 5000)
    assert read(4000, 3000, {0xA405: 50}, focal_35mm=27.0).fx == pytest.approx(50 / FULL_FRAME * 5000)
    with pytest.raises(CameraError, match="--focal-35mm"):
        read(4290, 2856, {0x920A: 30.0})
