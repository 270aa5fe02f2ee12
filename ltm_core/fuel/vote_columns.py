"""Votes as named columns of small numbers, the form used between nodes and in archives.

One value a cell: x, y, z float32 (its centre on the terrain), and one uint16 column of pixels for each class that the
frame saw, named after it. Where they are known: `confidence` of the labels and `cos_incidence`, uint8 x 255;
`footprint_dm`, `sigma_along_dm`, `sigma_across_dm` in decimetres and `bearing_deg`, uint16. Maps count what these
columns hold."""

import functools
import re
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import MessageError
from ltm_core.base.types import Columns, Int32Array, take
from ltm_core.fuel.rules import FRAME_CAP
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry

MAX_BYTES = 64_000
"""Maximum size in bytes of the message of a frame's votes."""
_HEADER_BYTES = 1_500
"""Upper bound in bytes for the header and field names of a message."""
_AXES = ("x", "y", "z")
_SCALED: Final[Mapping[str, tuple[type[np.unsignedinteger[Any]], int]]] = {
    "cos_incidence": (np.uint8, 255), "footprint_dm": (np.uint16, 10),
    "sigma_along_dm": (np.uint16, 10), "sigma_across_dm": (np.uint16, 10),
}  # fmt: skip
"""Type and factor of the columns of a visibility, in the order of `CellVisibility`; the last one is its bearing."""
_VISIBILITY = (*_SCALED, "bearing_deg")
_RESERVED = (*_AXES, "row", "col", "confidence", *_VISIBILITY)
_MOST = 65_535


def fitting(votes: CellVotes) -> CellVotes:
    """Return the votes that fit into a message of `MAX_BYTES`. Where there are more, the strongest take three quarters
    of the room, and the others take turns in the rest, so that the distance that a fixed camera sees is not left out
    for good. The turn depends on the stamp only, so that a frame has the same votes live and reprocessed."""
    of_classes = 2 * int(votes.counts.any(axis=0).sum())
    point = 12 + of_classes + (votes.confidence is not None) + (9 if votes.visibility is not None else 0)
    limit = (MAX_BYTES - _HEADER_BYTES) // point
    if len(votes) <= limit:
        return votes
    worth = np.minimum(votes.counts.sum(axis=1), FRAME_CAP)
    if votes.visibility is not None:
        worth *= votes.visibility.placement(votes.geometry.resolution)
    strongest, others = np.split(np.argsort(-worth, kind="stable"), [limit - limit // 4])
    rounds = -(-len(others) // (limit // 4))
    turn = zlib.crc32(votes.stamp_ns.to_bytes(8, "little", signed=True))
    return votes.only(np.sort(np.concatenate([strongest, np.sort(others)[turn % rounds :: rounds]])))


def votes_to_columns(votes: CellVotes, class_names: Sequence[str]) -> Columns:
    """Return votes as columns of N values; `class_names`: (K,) in the order of the counts' columns. Where a class has
    more pixels in a cell than a field holds, all of that cell's are scaled down. Raises MessageError when the names are
    not K distinct identifiers."""
    names = checked_names(tuple(class_names))
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
        *seen, bearing = votes.visibility.columns()
        for (name, (dtype, factor)), values in zip(_SCALED.items(), seen, strict=True):
            columns[name] = _scaled(values, factor, dtype)
        columns["bearing_deg"] = np.mod(np.rint(np.degrees(bearing)), 360).astype(np.uint16)
    return columns


def columns_to_votes(
    columns: Columns, geometry: GridGeometry, class_names: Sequence[str], stamp_ns: int, source: str
) -> CellVotes:
    """Return votes over the fuel grid `geometry`; `source`: the camera. Raises MessageError when columns are missing,
    foreign or of another type, a point lies outside the grid or not on the centre of a cell (then it was counted on
    another grid), or cells come twice or out of row-major order."""
    names = checked_names(tuple(class_names))
    what = f"votes of {source}"
    if foreign := sorted(columns.keys() - {*_AXES, "confidence", *_VISIBILITY, *names}):
        raise MessageError(f"{what} have the fields {', '.join(foreign)}; classes here are {', '.join(names)}")
    x, y, z = (take(columns, axis, np.float32, what) for axis in _AXES)
    rows, cols = _cells_at(x, y, geometry, what)
    counts = np.zeros((len(x), len(names)), np.uint32)
    for k, name in enumerate(names):
        if name in columns:
            counts[:, k] = take(columns, name, np.uint16, what)
    confidence = visibility = None
    if "confidence" in columns:
        confidence = take(columns, "confidence", np.uint8, what).astype(np.float32) / np.float32(255)
    if columns.keys() & set(_VISIBILITY):
        bearing = np.radians(take(columns, "bearing_deg", np.uint16, what).astype(np.float32))
        seen = [
            take(columns, name, dtype, what).astype(np.float32) / np.float32(factor)
            for name, (dtype, factor) in _SCALED.items()
        ]
        visibility = CellVisibility(*[*seen, bearing])
    return CellVotes(geometry, rows, cols, counts, z, stamp_ns, source, confidence, visibility)


def most_bytes(cells: int, class_names: Sequence[str]) -> int:
    """Return the maximum bytes of the columns of `cells` cells."""
    return cells * (4 * len(_AXES) + 2 * len(class_names) + 2 * len(_RESERVED))


@functools.lru_cache(maxsize=64)  # called twice for each frame, nearly always with the same names
def checked_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names. Raises MessageError unless they are distinct identifiers that no other column has."""
    bad = [n for n in names if n in _RESERVED or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", n)]
    if not names or bad or len(set(names)) != len(names):
        raise MessageError(f"vote classes must be distinct identifiers other than {', '.join(_RESERVED)}; got {names}")
    return names


def _cells_at(x: NDArray[Any], y: NDArray[Any], geometry: GridGeometry, what: str) -> tuple[Int32Array, Int32Array]:
    """Return the rows and columns of the cells whose centres these points are, in row-major order."""
    row, col = geometry.to_grid(x, y)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(2 * row - geometry.height + 1) < geometry.height) & (
            np.abs(2 * col - geometry.width + 1) < geometry.width
        )
        rows, cols = (
            np.rint(np.where(inside, row, 0)).astype(np.int32),
            np.rint(np.where(inside, col, 0)).astype(np.int32),
        )
        centred = np.maximum(np.abs(row - rows), np.abs(col - cols)) <= 0.01
    new = np.diff(rows.astype(np.int64) * geometry.width + cols, prepend=-1) > 0
    for good, problem in (
        (inside, f"outside a fuel grid of {geometry.shape} cells"),
        (centred, "not a cell centre: sender and receiver use different fuel grids"),
        (new, "duplicated or not in row-major order"),
    ):
        if not good.all():
            first = int(np.argmin(good))
            raise MessageError(f"{what}: point {first} at ({x[first]}, {y[first]}) is {problem}")
    return rows, cols


def _scaled(values: NDArray[Any], factor: float, dtype: Any) -> NDArray[Any]:
    """Round and clip to an unsigned integer type; NaN counts as the maximum."""
    most = np.iinfo(dtype).max
    return np.clip(np.rint(np.nan_to_num(values * factor, nan=most)), 0, most).astype(dtype)
