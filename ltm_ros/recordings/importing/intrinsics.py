"""Read a camera's intrinsics from the metadata of photos. No other code interprets them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from PIL.Image import Exif

from ltm_core.base.errors import CameraError
from ltm_core.cameras.camera_config import PartialCalibration
from ltm_ros.recordings.importing.exif import EXIF_IFD, ORIENTATION, positive, text_of

# Tag numbers: CIPA DC-008 (Exif 2.32), sections 4.6.4 and 4.6.5.
_MAKE, _INTEROPERABILITY_IFD, _RELATED_SIZE = 0x010F, 0xA005, (0x1001, 0x1002)
_PIXEL_SIZE, _PLANE_RESOLUTION, _PLANE_UNIT = (0xA002, 0xA003), (0xA20E, 0xA20F), 0xA210
_FOCAL_LENGTH, _FOCAL_LENGTH_35MM, _DIGITAL_ZOOM = 0x920A, 0xA405, 0xA404
_CUSTOM_RENDERED, _LENS_MODEL, _MAKER_NOTE = 0xA401, 0xA434, 0x927C
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}

FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)
"""The 35 mm equivalent refers to the diagonal of the image (CIPA)."""
_LEAST_FOV_DEG, _LARGEST_FOV_DEG = 5.0, 120.0
_AGREEMENT = 1.1
"""Maximum ratio of focal lengths that agree."""
_WIDEST_ASPECT = 2.2
_SAME_ASPECT = 0.01
_LEAST_FOCAL = 0.2
"""Least focal length as a share of the long side."""
_LEAST_SENSOR_MM = 4.4
"""Long side of the smallest sensor of a camera (1/3.2 inch); smaller ones are of digital zoom or of a resized image."""
_NO_SENSOR_MM = 29.5, 34.5
"""There is no sensor between APS-H and full frame; some cameras state one."""
_OFFSETS = {"fx": 0.0, "fy": 0.0, "cx": 0.5, "cy": 0.5}


@dataclass(frozen=True)
class LensFacts:
    """What metadata states about a lens; None or empty if it states nothing. Lengths in mm.

    `zoom`: digital zoom ratio; `zoom_included`: whether the 35 mm equivalent certainly includes it. `plane`: sensor
    pixels per mm. `size`: width and height as recorded. `untouched`: whether the camera wrote the file. `not_pinhole`:
    why it is no pinhole camera's image. `calibration`: in pixels of `size`."""

    focal_mm: float | None = None
    focal_35mm: float | None = None
    zoom: float = 1.0
    zoom_included: bool = False
    plane: tuple[float, ...] = ()
    size: tuple[float, float] | None = None
    untouched: bool = False
    not_pinhole: str = ""
    calibration: PartialCalibration = field(default_factory=PartialCalibration)


def intrinsics(
    lens: LensFacts, width: int, height: int, what: str, focal_35mm: float | None = None
) -> PartialCalibration:
    """Return the calibration of the upright image `what` of `width` x `height` pixels.

    `focal_35mm`: applies if the metadata states none. Raises CameraError if the image is not of a pinhole camera, is
    cropped, or its field of view is unknown, outside 5 to 120 degrees, or differs between sources by more than 10 %."""
    long, short = max(width, height), min(width, height)
    remedy = "give fx or hfov_deg in a pose file (--poses)"
    if lens.not_pinhole or long > _WIDEST_ASPECT * short:
        why = lens.not_pinhole or f"{width} x {height} pixels are a panorama"
        raise CameraError(f"{what}: {why}, not an image of a pinhole camera: use another photo, or {remedy}")
    scale = 1.0
    if lens.size is not None:
        scale = long / max(lens.size)
        if abs(short / min(lens.size) / scale - 1) > _SAME_ASPECT + 1 / short:
            sizes = f"of {lens.size[0]:g} x {lens.size[1]:g} pixels to {width} x {height}"
            raise CameraError(f"{what}: the image is cropped, {sizes}: use the original, or {remedy} with cx and cy")
    sources = _sources(lens, long, math.hypot(width, height), scale)
    if not sources and focal_35mm is not None:
        sources = {"--focal-35mm": [focal_35mm / FULL_FRAME_DIAGONAL_MM * math.hypot(width, height)]}
    if not sources:
        raise CameraError(f"{what}: its metadata does not give the focal length in pixels: {remedy}, or --focal-35mm")
    values = "; ".join(
        f"{name}: {' or '.join(f'{_fov_deg(f, long):.1f}' for f in focals)} deg" for name, focals in sources.items()
    )
    best = next(iter(sources.values()))
    agreed = [f for f in best if all(any(_agree(f, other) for other in others) for others in sources.values())]
    if not agreed or not _agree(agreed[0], agreed[-1]):
        raise CameraError(f"{what}: contradictory fields of view along the long side ({values}): {remedy}")
    if not _LEAST_FOV_DEG <= _fov_deg(agreed[0], long) <= _LARGEST_FOV_DEG:
        limits = f"outside {_LEAST_FOV_DEG:g} to {_LARGEST_FOV_DEG:g} deg"
        raise CameraError(f"{what}: field of view along the long side ({values}) {limits}: {remedy}")
    sensor_mm = (lens.focal_mm or 0.0) * long / agreed[0] * lens.zoom
    exists = sensor_mm >= _LEAST_SENSOR_MM and not _NO_SENSOR_MM[0] < sensor_mm < _NO_SENSOR_MM[1]
    if all(name.startswith("FocalPlane") for name in sources) and not (lens.untouched and exists):
        why = f"only the focal plane resolution gives the field of view ({values})"
        raise CameraError(f"{what}: {why}, and software that resizes an image leaves it unchanged: {remedy}")
    stated = lens.calibration
    if stated.fx is None or agreed[0] != stated.fx * scale:
        return PartialCalibration(fx=agreed[0])
    # Pixel centres are integers, so that the image begins at -0.5.
    known = {name: value + at for name, at in _OFFSETS.items() if (value := getattr(stated, name)) is not None}
    return stated.model_copy(update={name: value * scale - _OFFSETS[name] for name, value in known.items()})


def _sources(lens: LensFacts, long: int, diagonal: float, scale: float) -> dict[str, list[float]]:
    """Return possible focal lengths in pixels by source, the most accurate first; two with a doubtful zoom."""
    stated: dict[str, float] = {}
    if lens.calibration.fx is not None:
        stated["calibration in XMP"] = lens.calibration.fx * scale
    if lens.focal_mm is not None:
        for axis, resolution in zip("XY", lens.plane, strict=False):
            stated[f"FocalPlane{axis}Resolution"] = lens.focal_mm * resolution * scale
    if lens.focal_35mm is not None:
        name = f"35 mm equivalent {lens.focal_35mm:g} mm"
        stated[name] = lens.focal_35mm / FULL_FRAME_DIAGONAL_MM * diagonal
    sources = {}
    for name, focal in stated.items():
        if not focal:
            continue  # a product of tiny numbers
        sensor_mm = math.inf if lens.focal_mm is None else lens.focal_mm / focal * long
        included = lens.zoom <= _AGREEMENT or lens.zoom_included or sensor_mm < _LEAST_SENSOR_MM
        sources[name] = [focal] if included else [focal, focal * lens.zoom]
    return sources


def _agree(a: float, b: float) -> bool:
    return max(a, b) <= _AGREEMENT * min(a, b)


def _fov_deg(focal: float, side: float) -> float:
    return math.degrees(2 * math.atan2(side / 2, focal))


def lens_of_photo(exif: Exif, xmp: Mapping[str, str], width: int, height: int) -> LensFacts:
    """Return the facts of a photo's EXIF and XMP (`xmp_values`). `width`, `height`: of the upright image."""
    photo = exif.get_ifd(EXIF_IFD)
    recorded = _pair(photo, _PIXEL_SIZE)
    unit = _MM_PER_UNIT.get(photo.get(_PLANE_UNIT, 2))
    resolutions = [positive(photo.get(tag)) for tag in _PLANE_RESOLUTION]
    projection = xmp.get("GPano:ProjectionType", "equirectangular" if "GPano:FullPanoWidthPixels" in xmp else "")
    not_pinhole = ""
    if projection.lower() not in ("", "perspective", "rectilinear") or photo.get(_CUSTOM_RENDERED) == 6:
        not_pinhole = f"its metadata states a panorama ({projection or 'CustomRendered 6'})"
    if "fisheye" in (text_of(photo.get(_LENS_MODEL)) + xmp.get("Camera:ModelType", "")).lower().replace("-", ""):
        not_pinhole = "its metadata states a fisheye lens"
    plane = tuple(r / unit for r in resolutions if unit and r)
    size = _pair(exif.get_ifd(_INTEROPERABILITY_IFD), _RELATED_SIZE) or recorded
    calibration = _xmp_calibration(xmp, size or (width, height))
    as_recorded = exif.get(ORIENTATION, 1) == 1 and (size is None or (size[0] > size[1]) == (width > height))
    return LensFacts(
        focal_mm=positive(photo.get(_FOCAL_LENGTH)),
        focal_35mm=positive(photo.get(_FOCAL_LENGTH_35MM)),
        zoom=max(positive(photo.get(_DIGITAL_ZOOM)) or 1.0, 1.0),
        zoom_included=text_of(exif.get(_MAKE)) == "Apple",
        plane=plane,
        size=size,
        untouched=recorded is not None and _MAKER_NOTE in photo,
        not_pinhole=not_pinhole,
        calibration=calibration if as_recorded else PartialCalibration(fx=calibration.fx),
    )


def _xmp_calibration(xmp: Mapping[str, str], size: tuple[float, float]) -> PartialCalibration:
    """Return what DJI's drones state: dewarp data, or the calibrated focal length."""
    k1, k2, k3, p1, p2 = 0.0, 0.0, 0.0, 0.0, 0.0
    middle = [(side - 1) / 2 for side in size]
    dewarp = _numbers(xmp.get("drone-dji:DewarpData", "").partition(";")[2])
    focal = _numbers(xmp.get("drone-dji:CalibratedFocalLength", ""))
    centre = [v for axis in "XY" for v in _numbers(xmp.get(f"drone-dji:CalibratedOpticalCenter{axis}", ""))]
    if len(dewarp) == 9:
        focal, centre = dewarp[:2], [c + m for c, m in zip(dewarp[2:4], middle, strict=True)]
        if xmp.get("drone-dji:DewarpFlag") != "1":  # else the image is rectified
            k1, k2, p1, p2, k3 = dewarp[4:]
    if not focal or min(focal) < _LEAST_FOCAL * max(size):  # some models state millimetres
        return PartialCalibration()
    if len(centre) != 2 or any(abs(c - m) > 0.2 * m for c, m in zip(centre, middle, strict=True)):
        centre = middle
    cx, cy = centre
    return PartialCalibration(fx=focal[0], fy=focal[-1], cx=cx, cy=cy, k1=k1, k2=k2, k3=k3, p1=p1, p2=p2)


def _pair(tags: Mapping[int, Any], names: tuple[int, int]) -> tuple[float, float] | None:
    width, height = (positive(tags.get(name)) for name in names)
    return None if width is None or height is None else (width, height)


def _numbers(text: str) -> list[float]:
    """Return comma-separated numbers; none if one is invalid."""
    try:
        values = [float(part) for part in text.split(",")] if text.strip() else []
    except ValueError:
        return []
    return values if all(map(math.isfinite, values)) else []
