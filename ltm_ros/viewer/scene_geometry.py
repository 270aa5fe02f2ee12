"""Build the geometry of the 3D scene: terrain mesh, fuel layer draped on it, and initial viewpoint."""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float64Array, IndexArray, UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures import label_colors, terrain_colors
from ltm_core.pictures.legend import UNLABELLED, ClassPalette
from ltm_core.pictures.relief import coarser
from ltm_core.raster.dem import Dem

MAX_TRIANGLES = 300_000
MAX_TEXTURE = 2048
TILE = 32
"""Cells on a side of a fuel tile, the unit in which the fuel layer is logged again."""


Mesh = dict[str, NDArray[Any]]
"""Arrays of a mesh, by the names that Rerun's Mesh3D gives them."""


def decimated(dem: Dem, max_triangles: int = MAX_TRIANGLES) -> Dem:
    """Return every n-th height, so that the triangles stay within `max_triangles`."""
    height, width = dem.elevation.shape
    step = max(1, math.ceil(math.sqrt(2 * height * width / max_triangles)))
    step = min(step, height - 1, width - 1)
    g, elevation = dem.geometry, dem.elevation[::step, ::step]
    # The first sample keeps its place, half a fine cell inside the raster; it is now the centre of a coarse cell.
    inset = (step - 1) / 2 * g.resolution
    corner = g.x_min - inset, g.y_max + inset
    return Dem(elevation, GridGeometry(*corner, g.resolution * step, elevation.shape[1], elevation.shape[0], g.crs))


def terrain_mesh(dem: Dem) -> Mesh:
    """Return the terrain with tinted relief as its texture; no triangle touches a cell without height.

    It has no normals, because the texture contains the shading."""
    coarse = decimated(dem)
    rows, cols = coarse.elevation.shape
    row, col = np.mgrid[:rows, :cols]
    x, y = coarse.geometry.to_map(row, col)
    vertices = np.stack([x, y, coarse.elevation], axis=-1).reshape(-1, 3).astype(np.float32)
    index = np.arange(rows * cols, dtype=np.uint32).reshape(rows, cols)
    nw, ne, sw, se = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.concatenate([np.stack([nw, sw, ne], -1).reshape(-1, 3), np.stack([ne, sw, se], -1).reshape(-1, 3)])
    known = np.isfinite(vertices[:, 2])
    triangles = triangles[known[triangles].all(axis=1)]
    vertices[~known, 2] = 0.0
    fine = dem.geometry
    texcoords = np.stack(
        [(x - fine.x_min) / (fine.x_max - fine.x_min), (fine.y_max - y) / (fine.y_max - fine.y_min)], -1
    )
    return {
        "vertex_positions": vertices,
        "triangle_indices": triangles,
        "vertex_texcoords": texcoords.reshape(-1, 2).astype(np.float32),
        "albedo_texture": terrain_colors(coarser(dem, -(-max(dem.elevation.shape) // MAX_TEXTURE))),
    }


class FuelLayer:
    """Fuel cells as flat coloured quads just above the drawn terrain; only changed tiles are returned."""

    def __init__(self, dem: Dem, geometry: GridGeometry, palette: ClassPalette) -> None:
        self._surface = decimated(dem)
        self._geometry = geometry
        self._palette = palette
        # Quads and mesh meet the surface at different points; the lift keeps the mesh from poking through.
        self._lift = 0.12 * max(geometry.resolution, self._surface.geometry.resolution)
        self._shown = np.full(geometry.shape, UNLABELLED, np.uint8)

    def changed(self, classes: UInt8Array) -> Iterator[tuple[str, Mesh]]:
        """Return the name and the cells with evidence of each tile that differs from the last call: four vertices, each
        with a colour, and two triangles per cell. Raises RasterError for classes of another shape."""
        if classes.shape != self._geometry.shape:
            raise RasterError(f"classes of shape {classes.shape} do not fit a fuel grid of {self._geometry.shape}")
        rows, cols = np.nonzero(classes != self._shown)
        self._shown = classes.copy()
        for row, col in sorted(set(zip((rows // TILE).tolist(), (cols // TILE).tolist(), strict=True))):
            yield f"r{row:03d}_c{col:03d}", self._tile(row * TILE, col * TILE)

    def _tile(self, row: int, col: int) -> Mesh:
        part = self._shown[row : row + TILE, col : col + TILE]
        rows, cols = part.shape
        window = self._geometry.window(row, col, rows, cols)
        # A margin of one cell, so that neighbouring tiles meet.
        x = window.x_min + np.arange(-1, cols + 2) * window.resolution
        y = window.y_max - np.arange(-1, rows + 2) * window.resolution
        corners = np.stack([*np.meshgrid(x, y), self._surface.elevation_at(*np.meshgrid(x, y))], axis=-1)
        # Flat triangles cut through curved ground: raise their corners until no ground in a cell is above them.
        nw, sw, ne, se = corners[:-1, :-1], corners[1:, :-1], corners[:-1, 1:], corners[1:, 1:]
        under = np.zeros(nw.shape[:2])
        for east, south in itertools.product(np.linspace(0, 1, 5), repeat=2):
            upper = nw + east * (ne - nw) + south * (sw - nw)
            at = upper if east + south <= 1 else se + (1 - east) * (sw - se) + (1 - south) * (ne - se)
            under = np.fmax(under, self._surface.elevation_at(at[..., 0], at[..., 1]) - at[..., 2])
        corners = corners[1:-1, 1:-1].astype(np.float32)
        raised = np.max([under[:-1, :-1], under[1:, :-1], under[:-1, 1:], under[1:, 1:]], axis=0)
        corners[..., 2] += (self._lift + raised).astype(np.float32)
        quads = np.stack([corners[:-1, :-1], corners[1:, :-1], corners[:-1, 1:], corners[1:, 1:]], axis=2)
        seen = (part != UNLABELLED) & np.isfinite(quads[..., 2]).all(axis=2)
        first = 4 * np.arange(np.count_nonzero(seen), dtype=np.uint32)
        triangles = first[:, None, None] + np.array([[0, 1, 2], [2, 1, 3]], np.uint32)
        colors = np.repeat(label_colors(part[seen], self._palette), 4, axis=0)
        parts = {"vertex_positions": quads[seen].reshape(-1, 3), "triangle_indices": triangles.reshape(-1, 3)}
        return parts | {"vertex_colors": colors}


Eye = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Viewpoint and target of the 3D view (map frame)."""


def overview_eye(dem: Dem, positions: Float64Array, azimuths_deg: Float64Array, reach: float) -> Eye:
    """Return a viewpoint behind and above the cameras that shows all of them and the ground before them, and its
    target.

    `positions` (N, 3) and `azimuths_deg` (N,) of the cameras, `reach` metres ahead of each as far as the DEM extends;
    without a camera, the whole DEM from the south."""
    g = dem.geometry
    if len(positions):
        angles = np.deg2rad(azimuths_deg)
        headings = np.column_stack([np.sin(angles), np.cos(angles)])
        ahead = (positions[:, :2] + headings * reach).clip((g.x_min, g.y_min), (g.x_max, g.y_max))
        spots = np.vstack([positions[:, :2], ahead])
        behind = -headings.mean(axis=0)
    else:
        spots = np.array([[g.x_min, g.y_min], [g.x_max, g.y_max]])
        behind = np.array([0.0, -1.0])
    norm = float(np.hypot(*behind))
    behind = behind / norm if norm > 0.2 else np.array([0.0, -1.0])
    low, high = spots.min(axis=0), spots.max(axis=0)
    centre = (low + high) / 2
    radius = max(float(np.hypot(*(high - low))) / 2, 10 * g.resolution)
    ground = float(dem.elevation_at(*centre))
    if not math.isfinite(ground):
        ground = float(np.nanmean(dem.elevation))
    x, y = centre + behind * radius * 1.4
    # The viewpoint must not be inside a mountain behind the cameras.
    under = float(dem.elevation_at(x, y))
    height = max(ground + radius * 0.9, under + radius * 0.2 if math.isfinite(under) else -math.inf)
    return (float(x), float(y), height), (float(centre[0]), float(centre[1]), ground)


def thinned(points: NDArray[np.floating], most: int) -> IndexArray:
    """Return indices of at most `most` finite points (N, 3), evenly strided."""
    finite = np.nonzero(np.isfinite(points).all(axis=1))[0]
    return finite[:: max(1, math.ceil(len(finite) / most))]
