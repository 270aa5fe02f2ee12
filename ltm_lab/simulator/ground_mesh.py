"""Triangle mesh of a scene's ground (the site, its surroundings, a plain with ranges out to the horizon), and which of
that ground is visible from an eye point.

Earth curvature and refraction are in the shape: everything sinks by `bend` d^2 with its distance d from `center`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int64Array, UInt32Array
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.appearance import Reflectances
from ltm_lab.simulator.terrain_synthesis import HeightField

_FLATNESS = 0.03  # m that the site's triangles may lie off its bilinear surface
_MOST_PARTS = 8  # a cell's side is cut into so many at most
_HORIZON = 70_000.0  # m
_AZIMUTHS = 2048
_NEAR = 400.0  # m within which nothing counts as hidden
_LEDGE = 5.0  # m by which ground may be lower than the wide raster says
_STANDING = 24.0  # m, the tallest that stands on the ground
_SLACK = 36.0  # m: what lies so close behind a crest may still show, and throw shadows over it
_FAR = 1200.0  # m, where a cell begins to look narrow


@dataclass(frozen=True)
class Triangles:
    """`vertices` (N, 3) metres in the map frame and `faces` (M, 3); per vertex `uv` (N, 2) or `colors` (N, 3)."""

    vertices: Float32Array
    faces: UInt32Array
    uv: Float32Array | None = None
    colors: Float32Array | None = None


def _drop(x: Float64Array, y: Float64Array, center: Float64Array, bend: float) -> Float64Array:
    return np.asarray(bend * ((x - center[0]) ** 2 + (y - center[1]) ** 2), np.float64)


def seen_from(eye: Float64Array, center: Float64Array, bend: float) -> Float64Array:
    """The transform (4, 4) that takes ground sunk about `center` to ground sunk about `eye` (both at least (x, y)).

    The difference of two paraboloids of one curvature is a plane, so that a shear does it exactly.
    """
    shift = center[:2] - eye[:2]
    m = np.eye(4)
    m[2, :2] = -2 * bend * shift
    m[2, 3] = bend * (2 * float(center[:2] @ shift) - float(shift @ shift))
    return m


def _grid_faces(keep: BoolArray) -> UInt32Array:
    """Two triangles a quad of an (H, W) vertex grid, where `keep` (H-1, W-1) says so."""
    h, w = keep.shape[0] + 1, keep.shape[1] + 1
    index = np.arange(h * w, dtype=np.uint32).reshape(h, w)
    a, b, c, d = (q[keep] for q in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    return np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])


def twist_parts(elevation: Float32Array) -> Int64Array:
    """Into how many parts (H-1, W-1) a side of each quad must be cut for its triangles to follow the bilinear surface.

    Two triangles leave the bilinear surface by a quarter of the quad's twist, n^2 pairs of them by a part of n^2.
    """
    z = elevation.astype(np.float64)
    off = np.abs(z[:-1, :-1] - z[:-1, 1:] - z[1:, :-1] + z[1:, 1:]) / 4
    least = np.sqrt(np.maximum(off / _FLATNESS, 1.0))
    return np.asarray(np.minimum(2 ** np.ceil(np.log2(least)), _MOST_PARTS), np.int64)


def _cut_quads(corners: Float64Array, parts: int, first: int) -> tuple[Float64Array, UInt32Array]:
    """Vertices (N * (parts + 1)^2, K) and faces, numbered from `first`, of quads cut into parts x parts pieces.

    `corners` (N, 4, K): north-west, north-east, south-west, south-east. A bilinear surface is straight along the
    quad's sides, so that a cut quad meets an uncut neighbour without a gap.
    """
    down, right = (a.ravel() for a in np.meshgrid(*(np.linspace(0, 1, parts + 1),) * 2, indexing="ij"))
    weights = np.stack([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right], axis=1)
    vertices = np.einsum("pc,nck->npk", weights, corners).reshape(-1, corners.shape[-1])
    faces = _grid_faces(np.ones((parts, parts), bool))
    starts = first + len(weights) * np.arange(len(corners), dtype=np.uint32)
    return vertices, (starts[:, None, None].astype(np.uint32) + faces).reshape(-1, 3)


def field_triangles(
    field: HeightField,
    keep: BoolArray,
    center: Float64Array,
    bend: float,
    sink: float = 0.0,
    parts: Int64Array | None = None,
) -> Triangles:
    """The quads of `field` that `keep` (H-1, W-1) says, `sink` metres lower, each side cut into `parts` (H-1, W-1);
    uv spans the field's extent."""
    g = field.geometry
    x, y = np.meshgrid(*field.axes())
    z = field.elevation - _drop(x, y, center, bend) - sink
    uv = np.stack([(x - g.x_min) / (g.x_max - g.x_min), (g.y_max - y) / (g.y_max - g.y_min)], axis=-1)
    points = np.concatenate([np.stack([x, y, z], axis=-1), uv], axis=-1)
    parts = np.ones(keep.shape, np.int64) if parts is None else parts
    vertices, faces = [points.reshape(-1, 5)], [_grid_faces(keep & (parts == 1))]
    first = len(vertices[0])
    for n in np.unique(parts[parts > 1]):
        chosen = keep & (parts == n)
        quads = (points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:])
        cut, cut_faces = _cut_quads(np.stack([q[chosen] for q in quads], axis=1), int(n), first)
        vertices.append(cut)
        faces.append(cut_faces)
        first += len(cut)
    merged = np.concatenate([v.astype(np.float32) for v in vertices])
    return Triangles(merged[:, :3], np.concatenate(faces), uv=merged[:, 3:])


def under(wide: HeightField, site: HeightField) -> BoolArray:
    """The quads (H-1, W-1) of `wide` that lie wholly under `site`, a margin left."""
    x, y = np.meshgrid(*wide.axes())
    margin = 1.5 * wide.geometry.resolution
    g = site.geometry
    inside = (x > g.x_min + margin) & (x < g.x_max - margin) & (y > g.y_min + margin) & (y < g.y_max - margin)
    return np.asarray(inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:], np.bool_)


def far_radii(half: float) -> Float64Array:
    """The 92 radii of `far_surface` about surroundings of twice `half` metres; out to three times `half` each ring goes
    over from a square to a circle."""
    return np.concatenate([[0.97 * half, 1.0 * half], np.geomspace(1.1 * half, _HORIZON, 90)])


def far_surface(
    wide: HeightField, seed: int, center: Float64Array, bend: float
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """x, y, z (92, 721), from the inside out and round, of a plain with mountain ranges from the edge of the
    surroundings `wide` to 70 km, sunk as `bend` has it."""
    g = wide.geometry
    middle = np.array([(g.x_min + g.x_max) / 2, (g.y_min + g.y_max) / 2])
    half = (g.x_max - g.x_min) / 2
    edge = float(np.median(np.concatenate([wide.elevation[[0, -1]].ravel(), wide.elevation[:, [0, -1]].ravel()])))
    radius, angle = far_radii(half), np.linspace(0, 2 * np.pi, 721)
    # A square inner edge that follows the surroundings' border, a circle far out
    square = 1 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
    blend = np.clip((radius[:, None] - half) / (2 * half), 0, 1)
    reach = radius[:, None] * ((1 - blend) * square + blend)
    x, y = middle[0] + reach * np.cos(angle), middle[1] + reach * np.sin(angle)
    rise = np.clip((reach - 1.3 * half) / 16_000.0, 0, 1)
    ridges = 1 - 2 * np.abs(noise_fields.at_points(x.ravel(), y.ravel(), 9000.0, seed + 501)).reshape(x.shape)
    rough = noise_fields.at_points(x.ravel(), y.ravel(), 1700.0, seed + 503).reshape(x.shape)
    z = (
        edge
        - 40.0
        + rise * (950.0 * np.clip(ridges, -0.2, 1) ** 2 + 160.0 * rough)
        + 35.0 * rough * np.clip(rise * 8, 0, 1)
    )
    z[0] = edge - 120.0
    z -= _drop(x, y, center, bend)
    return x, y, z


def far_ranges(wide: HeightField, colors: Reflectances, seed: int, center: Float64Array, bend: float) -> Triangles:
    """The mountain ranges of `far_surface`, for the horizon."""
    x, y, z = far_surface(wide, seed, center, bend)
    color = 0.62 * colors.chamise + 0.2 * colors.grass + 0.18 * colors.soil
    tint = 1 + 0.5 * noise_fields.at_points(x.ravel(), y.ravel(), 1500.0, seed + 507)[:, None]
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    faces = _grid_faces(np.ones((x.shape[0] - 1, x.shape[1] - 1), bool))
    shades = np.clip(color * tint, 0.02, 0.6)
    return Triangles(vertices.astype(np.float32), faces, colors=shades.astype(np.float32))


@dataclass(frozen=True)
class VisibleGround:
    """Square cells of `side` metres, centred at (x0 + col side, y0 + row side): `seen` (rows, cols) says which may
    show."""

    seen: BoolArray
    x0: float
    y0: float
    side: float

    def at(self, x: ArrayLike, y: ArrayLike) -> BoolArray:
        """Whether the cells of map points may show; outside them: no."""
        col = np.rint((np.asarray(x) - self.x0) / self.side).astype(np.int64)
        row = np.rint((np.asarray(y) - self.y0) / self.side).astype(np.int64)
        rows, cols = self.seen.shape
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        return np.asarray(inside & self.seen[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)], np.bool_)


def line_of_sight(ground: HeightField, eye: Float64Array, side: float, bend: float) -> VisibleGround:
    """Which cells of `side` metres over `ground` hold something that may show from map point `eye` (3,).

    Errs on the side of showing: the ground that hides counts as lower and nearer than it is, what it hides as taller
    and wider. `bend`: metres that the earth sinks a square metre of distance.
    """
    g = ground.geometry
    step = g.resolution
    corners = np.hypot(np.array([g.x_min, g.x_max]) - eye[0], np.array([[g.y_min], [g.y_max]]) - eye[1])
    reach = np.arange(1, int(corners.max() / step) + 2) * step
    azimuth = np.arange(_AZIMUTHS) * (2 * np.pi / _AZIMUTHS)
    z = ground.at(eye[0] + np.sin(azimuth)[:, None] * reach, eye[1] + np.cos(azimuth)[:, None] * reach)
    slope = (z - _LEDGE - bend * reach**2 - eye[2]) / reach
    horizon = np.maximum.accumulate(slope, axis=1)
    narrow, wide = (
        ndimage.minimum_filter1d(
            horizon, 2 * int(np.ceil(0.75 * side / r / (2 * np.pi) * _AZIMUTHS)) + 1, 0, mode="wrap"
        )
        for r in (_FAR, _NEAR)
    )
    xs = np.arange(g.x_min, g.x_max + side, side)
    ys = np.arange(g.y_min, g.y_max + side, side)
    x, y = np.meshgrid(xs, ys)
    away = np.hypot(x - eye[0], y - eye[1])
    turn = np.rint(np.arctan2(x - eye[0], y - eye[1]) / (2 * np.pi) * _AZIMUTHS).astype(np.int64) % _AZIMUTHS
    before = np.clip(((away - _SLACK) / step).astype(np.int64) - 1, 0, len(reach) - 1)
    over = np.where(away > _FAR, narrow[turn, before], wide[turn, before])
    top = ndimage.maximum_filter(ground.at(x, y), 3) + _STANDING - bend * away**2
    seen = (away < _NEAR) | ((top - eye[2]) / np.maximum(away, 1.0) >= over)
    return VisibleGround(ndimage.binary_dilation(seen, np.ones((3, 3), bool)), float(xs[0]), float(ys[0]), side)
