"""Convert named columns and votes to PointCloud2, and back.

Votes are one point a cell, with the columns of `ltm_core.fuel.vote_columns` as fields, so that any ROS tool shows
them."""

import sys
from array import array as byte_array
from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from ltm_core.base.errors import MessageError
from ltm_core.base.types import Columns
from ltm_core.fuel.vote_columns import checked_names, columns_to_votes, most_bytes, votes_to_columns
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_msgs_py.stamp import make_header, stamp_of

_DTYPES: dict[int, np.dtype[Any]] = {
    getattr(PointField, name.upper()): np.dtype(name)
    for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
}
_DATATYPES = {dtype: datatype for datatype, dtype in _DTYPES.items()}
_LARGEST_POINT = 2**31 - 1
"""Maximum bytes of a point, NumPy's limit for records."""


def columns_to_msg(columns: Columns, stamp_ns: int, is_dense: bool = True) -> PointCloud2:
    """Columns of N values each, packed without gaps in their order, as an unorganised PointCloud2.

    Raises MessageError on columns of unequal length or of a dtype that PointField does not have."""
    lengths = {name: column.shape for name, column in columns.items()}
    if len(set(lengths.values())) != 1 or any(len(shape) != 1 for shape in lengths.values()):
        raise MessageError(f"point columns must be one-dimensional and of equal length, got {lengths}")
    (count,) = next(iter(lengths.values()))
    fields, dtypes, offset = [], [], 0
    for name, column in columns.items():
        if column.dtype not in _DATATYPES:
            taken = ", ".join(str(dtype) for dtype in _DATATYPES)
            raise MessageError(f"point column {name!r} is {column.dtype}; PointField has {taken}")
        fields.append(PointField(name=name, offset=offset, datatype=_DATATYPES[column.dtype], count=1))
        dtypes.append((name, column.dtype))
        offset += column.dtype.itemsize
    points = np.empty(count, np.dtype(dtypes))
    for name, column in columns.items():
        points[name] = column
    msg = PointCloud2(header=make_header(stamp_ns, "map"), height=1, width=count, fields=fields)
    msg.is_bigendian = sys.byteorder == "big"
    msg.point_step, msg.row_step = offset, offset * count
    msg.is_dense = is_dense
    data = byte_array("B")
    data.frombytes(points.tobytes())
    msg.data = data
    return msg


def msg_to_columns(msg: Any) -> Columns:
    """Return the columns of a PointCloud2 by name, each (N,) in native byte order, N = height * width.

    Raises MessageError for contradictory sizes, and fields beyond the point, twice, unknown, or of several elements."""
    height, width = int(msg.height), int(msg.width)
    point_step, row_step, size = int(msg.point_step), int(msg.row_step), len(msg.data)
    fits = 1 <= point_step <= _LARGEST_POINT and row_step >= width * point_step
    if min(height, width) < 0 or not fits or size != height * row_step:
        raise MessageError(
            f"PointCloud2 of height {height}, width {width}, point_step {point_step}, row_step {row_step} holds {size} "
            f"bytes; row_step must be at least width * point_step = {width * point_step}, data height * row_step"
        )
    names, formats, offsets = [], [], []
    for field in msg.fields:
        dtype = _DTYPES.get(int(field.datatype))
        if dtype is None or field.count != 1:
            what = f"PointCloud2 field {field.name!r} has datatype {field.datatype} and count {field.count}"
            raise MessageError(f"{what}; supported: datatypes {min(_DTYPES)}..{max(_DTYPES)}, one element each")
        if field.name in names:
            raise MessageError(f"PointCloud2 has duplicate field {field.name!r}")
        if field.offset < 0 or field.offset + dtype.itemsize > point_step:
            what = f"PointCloud2 field {field.name!r} at offset {field.offset}"
            raise MessageError(f"{what} exceeds its point of {point_step} bytes")
        names.append(field.name)
        formats.append(dtype.newbyteorder(">" if msg.is_bigendian else "<"))
        offsets.append(int(field.offset))
    if not names:
        raise MessageError("PointCloud2 has no fields")
    layout = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step})
    rows = np.frombuffer(msg.data, np.uint8).reshape(height, row_step)[:, : width * point_step]
    points = np.ascontiguousarray(rows).reshape(-1).view(layout)
    return {name: np.ascontiguousarray(points[name], points[name].dtype.newbyteorder("=")) for name in names}


def votes_to_msg(votes: CellVotes, class_names: Sequence[str]) -> PointCloud2:
    """Return votes as points; `class_names`: (K,) of the counts' columns. Raises MessageError."""
    columns = votes_to_columns(votes, class_names)
    dense = all(np.isfinite(columns[axis]).all() for axis in ("x", "y", "z"))
    return columns_to_msg(columns, votes.stamp_ns, is_dense=dense)


def msg_to_votes(msg: Any, geometry: GridGeometry, class_names: Sequence[str], source: str) -> CellVotes:
    """Votes over the fuel grid `geometry` of the receiver; `source`: the camera, which only the topic names.

    Raises MessageError as `columns_to_votes` does, and, before reading, for sizes that exceed the grid's."""
    names = checked_names(class_names)
    cells = geometry.width * geometry.height
    most = most_bytes(cells, names)
    if int(msg.height) * int(msg.width) > cells or len(msg.data) > most:
        raise MessageError(
            f"votes of {source} state {int(msg.height) * int(msg.width)} cells in {len(msg.data)} bytes; the fuel "
            f"grid has {cells}, whose votes have at most {most} bytes"
        )
    return columns_to_votes(msg_to_columns(msg), geometry, names, stamp_of(msg), source)
