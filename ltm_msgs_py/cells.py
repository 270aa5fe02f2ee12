"""Convert fuel cells and surface changes to PointCloud2 and OccupancyGrid, and versions of the surface to a status."""

import re
from typing import Any, Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from ltm_core.base.errors import MessageError
from ltm_core.base.types import Float32Array, take
from ltm_core.fuel.decision import FuelLayers
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.change import Changed, ChangeKind
from ltm_core.surface.confirmed_surface import AS_GIVEN, VERSION, SurfaceManifest
from ltm_msgs_py.pointcloud import columns_to_msg, msg_to_columns
from ltm_msgs_py.status import msg_to_values, status_to_msg

_FIELDS: Final[dict[str, Any]] = {
    "life_form": np.uint8,
    "prior": np.int16,
    "code": np.int16,
    "p_max": np.float32,
    "entropy": np.float32,
    "evidence": np.float32,
    "changed": np.uint8,
    "seen_by": np.uint8,
}


def fuel_cells_to_msg(
    layers: FuelLayers, heights: NDArray[np.floating], geometry: GridGeometry, stamp_ns: int
) -> PointCloud2:
    """Return the cells with evidence; `heights`: (H, W) metres of the terrain at the cells' centres."""
    rows, cols = np.nonzero((layers.last_seen > 0) | layers.changed)
    x, y = geometry.to_map(rows, cols)
    z = np.asarray(heights[rows, cols], np.float32)
    columns: dict[str, NDArray[Any]] = {"x": x.astype(np.float32), "y": y.astype(np.float32), "z": z}
    columns |= {name: getattr(layers, name)[rows, cols].astype(dtype) for name, dtype in _FIELDS.items()}
    return columns_to_msg(columns, stamp_ns, is_dense=bool(np.isfinite(z).all()))


_WHAT = "terrain update"


def changed_to_msg(changed: Changed, heights: Float32Array, geometry: GridGeometry, stamp_ns: int) -> PointCloud2:
    """Return changed cells as points. `heights`: (N,) of the updated surface there; `geometry`: the terrain's grid."""
    x, y = geometry.to_map(changed.rows, changed.cols)
    columns: dict[str, NDArray[Any]] = {
        name: values.astype(np.float32) for name, values in (("x", x), ("y", y), ("z", heights))
    }
    columns |= {"row": changed.rows.astype(np.int32), "col": changed.cols.astype(np.int32)}
    columns |= {"change": changed.kind.astype(np.uint8), "shift": changed.shift.astype(np.float32)}
    return columns_to_msg(columns, stamp_ns, is_dense=bool(np.isfinite(heights).all()))


def msg_to_changed(msg: Any) -> tuple[Changed, Float32Array]:
    """Return changed cells, with kind 0 before, and places (N, 3) x, y, z. Raises MessageError for invalid fields."""
    columns = msg_to_columns(msg)
    rows, cols = (take(columns, name, np.int32, _WHAT) for name in ("row", "col"))
    kind = take(columns, "change", np.uint8, _WHAT)
    shift, *place = (take(columns, name, np.float32, _WHAT) for name in ("shift", "x", "y", "z"))
    if (kind > max(ChangeKind)).any():
        raise MessageError(f"{_WHAT}: change is {int(kind.max())}; valid kinds are 0 to {max(ChangeKind)}")
    return Changed(rows, cols, np.zeros_like(kind), kind, shift), np.column_stack(place)


def manifest_to_msg(manifest: SurfaceManifest) -> DiagnosticArray:
    """Return the version in use, its digest and the shares of cells seen and changed."""
    entry = manifest.entry(manifest.current)
    values: dict[str, object] = {"version": manifest.current}
    if entry is not None:
        values |= entry.model_dump(exclude={"version"}) | {
            "seen_share": round(entry.seen / entry.cells, 4),
            "changed_share": round(entry.changed_share, 4),
        }
    return status_to_msg("terrain/surface", 0 if entry is None else entry.as_of_ns, values)


def msg_to_version(msg: Any) -> str:
    """Return the version that a message names, which is never a path. Raises MessageError without one."""
    version = msg_to_values(msg).get("version")
    if version == AS_GIVEN or (version is not None and re.fullmatch(VERSION, version, re.ASCII)):
        return version
    raise MessageError(f"version {str(version)[:80]!r}: expected 16 hexadecimal digits, or nothing")


def traced_to_msg(camera: str, stamp_ns: int, version: str) -> DiagnosticArray:
    """Return the version to which the frame of a stamp was traced; AS_GIVEN: to the site's rasters."""
    return status_to_msg(f"{camera}/depth", stamp_ns, {"version": version})
