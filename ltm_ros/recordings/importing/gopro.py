"""Reads the telemetry of GoPro cameras: GPMF (key, length, value; big-endian, aligned to four bytes) in a track `gpmd`.

Streams: GPS5 with GPSU, GPSF and GPSP (until HERO 10), GPS9 (from HERO 11 on). Altitudes are above the ellipsoid unless
GPSA says `MSLV`. There is no heading (the course of travel is none), and gravity is given in axes that differ between
models, so that direction and pitch stay unknown. Source: GoPro's gpmf-parser, README.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float64Array
from ltm_ros.recordings.importing.sensor_track import Fixes, SensorTrack, ascending

SOURCE = "GoPro GPMF"
_FORMATS = {"b": "b", "B": "B", "s": "h", "S": "H", "l": "i", "L": "I", "f": "f", "d": "d", "j": "q", "J": "Q"}
_DEEPEST = 8
_METRES_A_DOP = 4.0
"""Of position for each unit of dilution of precision: the error of a single-frequency receiver under open sky."""
_FIX_3D = 3
_DAY_0 = datetime(2000, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class Item:
    """One entry: its key, the type, size and number of its values, and their bytes."""

    key: str
    type: str
    size: int
    repeat: int
    data: bytes


def items(data: bytes) -> Iterator[Item]:
    """The entries of one level; nested ones have an empty type. Raises RecordingError where one reaches beyond."""
    at = 0
    while at + 8 <= len(data):
        key, kind, size, repeat = struct.unpack_from(">4sBBH", data, at)
        if key == b"\0\0\0\0":
            return
        length = size * repeat
        if at + 8 + length > len(data):
            raise RecordingError(f"GPMF entry {key!r} of {length} bytes reaches beyond its {len(data)} bytes")
        name = key.decode("ascii", "replace")
        yield Item(name, chr(kind) if kind else "", size, repeat, data[at + 8 : at + 8 + length])
        at += 8 + (length + 3) // 4 * 4


def streams(data: bytes, depth: int = 0) -> Iterator[list[Item]]:
    """The entries of each STRM, however deep it lies."""
    if depth > _DEEPEST:
        return
    for item in items(data):
        if item.type == "":
            if item.key == "STRM":
                yield list(items(item.data))
            else:
                yield from streams(item.data, depth + 1)


def values(item: Item, kinds: str = "") -> Float64Array:
    """(repeat, columns) float64 of numeric entries; `kinds`: of the columns, where the entry's own type is complex."""
    if item.type != "?":
        kinds = item.type * (item.size // max(struct.calcsize(_FORMATS.get(item.type, "b")), 1))
    try:
        row = struct.Struct(">" + "".join(_FORMATS[kind] for kind in kinds))
    except KeyError:
        return np.zeros((0, 0))
    if row.size == 0 or row.size != item.size:
        return np.zeros((0, 0))
    return np.array([row.unpack_from(item.data, k * row.size) for k in range(item.repeat)], np.float64)


def read_gopro(packets: Sequence[tuple[float, bytes]], path: Path) -> tuple[SensorTrack, datetime | None]:
    """The fixes of the `gpmd` track's packets (seconds, bytes), by stamps that count from 1 at the video's begin, and
    when that was by the GPS clock: UTC, None where no fix tells it. Raises RecordingError for packets that are no GPMF.
    """
    rows: list[tuple[float, float, float, float, float, float]] = []  # seconds, lon, lat, altitude, sigma, sea level
    begins: list[datetime] = []
    try:
        for index, (seconds, data) in enumerate(packets):
            span = packets[index + 1][0] - seconds if index + 1 < len(packets) else 1.0
            for stream in streams(data):
                found, clock = _fixes(stream, seconds, span)
                rows += found
                if clock is not None:
                    begins.append(clock - timedelta(seconds=seconds))
    except (RecordingError, struct.error, OverflowError) as error:
        raise RecordingError(
            f"{path}: its telemetry is damaged ({error}); copy the video from the camera again"
        ) from error
    if not rows:
        return SensorTrack(SOURCE), None
    start = sorted(begins)[len(begins) // 2] if begins else None
    table = np.array(rows)
    stamps = 1 + np.rint(table[:, 0] * 1e9).astype(np.int64)
    order = ascending(stamps)
    t = table[order]
    unknown = np.full(len(order), np.nan)
    sea = bool(t[:, 5].all())
    return SensorTrack(SOURCE, Fixes(stamps[order], t[:, 1], t[:, 2], t[:, 3], t[:, 4], unknown, not sea)), start


def _fixes(
    stream: list[Item], seconds: float, span: float
) -> tuple[list[tuple[float, float, float, float, float, float]], datetime | None]:
    """Rows of one stream of one packet, spread evenly over its `span` of seconds, and the GPS clock at its begin."""
    by_key = {item.key: item for item in stream}
    item = by_key.get("GPS9") or by_key.get("GPS5")
    if item is None:
        return [], None
    kinds = by_key["TYPE"].data.decode("ascii", "replace").strip("\0") if "TYPE" in by_key else ""
    table = values(item, kinds)
    scale = values(by_key["SCAL"]).ravel() if "SCAL" in by_key else np.ones(1)
    if not table.size or table.shape[1] < 5 or not (scale != 0).all() or len(scale) not in (1, table.shape[1]):
        return [], None
    table = table / scale
    lat, lon, altitude = table[:, 0], table[:, 1], table[:, 2]
    if item.key == "GPS9" and table.shape[1] >= 9:
        dop, fix, clock = table[:, 7], table[:, 8], _since_2000(table[0, 5], table[0, 6])
    else:
        dop = np.full(len(table), _one(by_key, "GPSP", 9999.0) / 100)
        fix, clock = np.full(len(table), _one(by_key, "GPSF", 0.0)), _utc(by_key.get("GPSU"))
    sea = by_key["GPSA"].data[:4] == b"MSLV" if "GPSA" in by_key else False
    good = (fix >= _FIX_3D) & (np.abs(lat) <= 90) & (np.abs(lon) <= 180) & ((lat != 0) | (lon != 0))
    times = seconds + span * np.arange(len(table)) / len(table)
    rows = [
        (
            float(times[k]),
            float(lon[k]),
            float(lat[k]),
            float(altitude[k]),
            float(_METRES_A_DOP * max(dop[k], 0.5)),
            float(sea),
        )
        for k in np.nonzero(good)[0]
    ]
    return rows, clock if rows else None


def _one(by_key: dict[str, Item], key: str, default: float) -> float:
    table = values(by_key[key]) if key in by_key else np.zeros(0)
    return float(table.ravel()[0]) if table.size else default


def _utc(item: Item | None) -> datetime | None:
    """GPSU: yymmddhhmmss.sss."""
    text = item.data.decode("ascii", "replace").strip("\0 ") if item is not None else ""
    try:
        return datetime.strptime(text, "%y%m%d%H%M%S.%f").replace(tzinfo=UTC)
    except ValueError:
        return None


def _since_2000(days: float, seconds: float) -> datetime | None:
    try:
        return _DAY_0 + timedelta(days=days, seconds=seconds)
    except (OverflowError, ValueError):
        return None
