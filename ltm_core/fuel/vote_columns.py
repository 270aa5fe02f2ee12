"""Votes as named columns of small numbers, the form used between nodes and in archives.

One value a cell: x, y, z float32 (its centre on the terrain), and one uint16 column of pixels for each class that the
frame saw, named after it. Where they are known: `confidence` of the labels and `cos_incidence`, uint8 x 255;
`footprint_dm`, `sigma_along_dm`, `sigma_across_dm` in decimetres and `bearing_deg`, uint16. So votes are sparse and
name the classes that they count. Maps count what comes out of these columns, whichever way it came."""

from __future__ import annotations

import functools
import re
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import MessageError
from ltm_core.base.types import Columns, Int32Array, Int64Array, take
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry

MAX_BYTES = 64_000
"""Maximum size in bytes of the message of a frame's votes."""
_HEADER_BYTES = 1_500
"""Upper bound in bytes for the header and field names of a message."""
_AXES = ("x", "y", "z")
_LENGTHS = ("footprint_dm", "sigma_along_dm", "sigma_across_dm")
_VISIBILITY = ("cos_incidence", *_LENGTHS, "bearing_deg")
_RESERVED = (*_AXES, "row", "col", "confidence", *_VISIBILITY)
_MOST = 65_535


def fitting(votes: CellVotes, turn: int) -> CellVotes:
    """Return the votes that fit into a message of `MAX_BYTES`.

    Where there are more, the strongest take three quarters of the room and the others take turns in the rest, so that
    the distance that a fixed camera sees is not left out for good. `turn`: any number, another one for each frame."""
    limit = (MAX_BYTES - _HEADER_BYTES) // _point_bytes(votes)
    if len(votes) <= limit:
        return votes
    chosen = np.isin(_cells(votes), _cells(votes.strongest(limit - limit // 4)))
    others = np.flatnonzero(~chosen)
    rounds = -(-len(others) // (limit // 4))
    chosen[others[turn % rounds :: rounds]] = True
    return votes.only(chosen)


def turn_of(stamp_ns: int) -> int:
    """Return a number that depends on the stamp only, for `fitting`, so that a frame has the same votes live and
    reprocessed."""
    return zlib.crc32(stamp_ns.to_bytes(8, "little", signed=True))


def votes_to_columns(votes: CellVotes, class_names: Sequence[str]) -> Columns:
    """Return votes as columns of N values; `class_names`: (K,) in the order of the counts' columns.

    Where a class has more pixels in a cell than a field holds, all of that cell's are scaled down. Raises MessageError
    when the names are not K distinct identifiers."""
    names = checked_names(class_names)
    if votes.counts.shape[1] != len(names):
        raise MessageError(
            f"votes of {votes.source} count {votes.counts.shape[1]} classes, but {len(names)} are named: "
            f"{', '.join(names)}"
        )
    centres = votes.centres()
    columns: Columns = {axis: centres[:, i] for i, axis in enumerate(_AXES)}
    scale = np.minimum(1.0, _MOST / np.maximum(votes.counts.max(axis=1, initial=1), 1))
    for k, name in enumerate(names):
        if votes.counts[:, k].any():
            columns[name] = np.rint(votes.counts[:, k] * scale).astype(np.uint16)
    if votes.confidence is not None:
        columns["confidence"] = _scaled(votes.confidence, 255, np.uint8)
    if votes.visibility is not None:
        seen = votes.visibility
        columns["cos_incidence"] = _scaled(seen.cos_incidence, 255, np.uint8)
        for name, length in zip(_LENGTHS, (seen.footprint, seen.sigma_along, seen.sigma_across), strict=True):
            columns[name] = _scaled(length, 10, np.uint16)
        columns["bearing_deg"] = np.mod(np.rint(np.degrees(seen.bearing)), 360).astype(np.uint16)
    return columns


def columns_to_votes(
    columns: Columns, geometry: GridGeometry, class_names: Sequence[str], stamp_ns: int, source: str
) -> CellVotes:
    """Return votes over the fuel grid `geometry`; `source`: the camera.

    Raises MessageError when columns are missing, foreign or of another type, a point lies outside the grid or not on
    the centre of a cell (then it was counted on another grid), or cells come twice or out of row-major order."""
    names = checked_names(class_names)
    what = f"votes of {source}"
    if foreign := sorted(columns.keys() - {*_AXES, "confidence", *_VISIBILITY, *names}):
        raise MessageError(f"{what} have the fields {', '.join(foreign)}; classes here are {', '.join(names)}")
    x, y, z = (take(columns, axis, np.float32, what) for axis in _AXES)
    rows, cols = _cells_at(x, y, geometry, what)
    counts = np.zeros((len(x), len(names)), np.uint32)
    for k, name in enumerate(names):
        if name in columns:
            counts[:, k] = take(columns, name, np.uint16, what)
    confidence = None
    if "confidence" in columns:
        confidence = take(columns, "confidence", np.uint8, what).astype(np.float32) / np.float32(255)
    return CellVotes(geometry, rows, cols, counts, z, stamp_ns, source, confidence, _visibility(columns, what))


def most_bytes(cells: int, class_names: Sequence[str]) -> int:
    """Return the maximum bytes of the columns of `cells` cells."""
    return cells * (4 * len(_AXES) + 2 * len(class_names) + 2 * len(_RESERVED))


def checked_names(class_names: Sequence[str]) -> tuple[str, ...]:
    """Return the names. Raises MessageError unless they are distinct identifiers that no other column has."""
    return _checked(tuple(class_names))


@functools.lru_cache(maxsize=64)
def _checked(names: tuple[str, ...]) -> tuple[str, ...]:
    """Asked twice for each frame, nearly always of the same names."""
    bad = [n for n in names if n in _RESERVED or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", n)]
    if not names or bad or len(set(names)) != len(names):
        raise MessageError(f"vote classes must be distinct identifiers other than {', '.join(_RESERVED)}; got {names}")
    return names


def _cells_at(x: NDArray[Any], y: NDArray[Any], geometry: GridGeometry, what: str) -> tuple[Int32Array, Int32Array]:
    """Return the rows and columns of the cells whose centres these points are."""
    row, col = geometry.to_grid(x, y)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(2 * row - geometry.height + 1) < geometry.height) & (
            np.abs(2 * col - geometry.width + 1) < geometry.width
        )
    if not inside.all():
        first = int(np.argmin(inside))
        raise MessageError(
            f"{what}: point {first} at ({x[first]}, {y[first]}) is outside a fuel grid of {geometry.shape} cells"
        )
    rows, cols = np.rint(row).astype(np.int32), np.rint(col).astype(np.int32)
    centred = np.maximum(np.abs(row - rows), np.abs(col - cols)) <= 0.01
    if not centred.all():
        first = int(np.argmin(centred))
        raise MessageError(
            f"{what}: point {first} at ({x[first]}, {y[first]}) is not a cell centre: sender and receiver use "
            "different fuel grids"
        )
    steps = np.diff(rows.astype(np.int64) * geometry.width + cols)
    if (steps <= 0).any():
        first = int(np.argmax(steps <= 0)) + 1
        raise MessageError(
            f"{what}: point {first} is cell ({rows[first]}, {cols[first]}), which is duplicated or not in "
            "row-major order"
        )
    return rows, cols


def _visibility(columns: Columns, what: str) -> CellVisibility | None:
    if not columns.keys() & set(_VISIBILITY):
        return None
    cosine = take(columns, "cos_incidence", np.uint8, what).astype(np.float32) / np.float32(255)
    footprint, along, across = (
        take(columns, name, np.uint16, what).astype(np.float32) / np.float32(10) for name in _LENGTHS
    )
    bearing = np.radians(take(columns, "bearing_deg", np.uint16, what).astype(np.float32))
    return CellVisibility(cosine, footprint, along, across, bearing)


def _scaled(values: NDArray[Any], factor: float, dtype: Any) -> NDArray[Any]:
    """Round and clip to an unsigned integer type; NaN counts as the maximum."""
    most = np.iinfo(dtype).max
    return np.clip(np.rint(np.nan_to_num(values * factor, nan=most)), 0, most).astype(dtype)


def _point_bytes(votes: CellVotes) -> int:
    classes = int(votes.counts.any(axis=0).sum())
    return 12 + 2 * classes + (votes.confidence is not None) + (9 if votes.visibility is not None else 0)


def _cells(votes: CellVotes) -> Int64Array:
    return votes.rows.astype(np.int64) * votes.geometry.width + votes.cols
