"""The Mitsuba scene seen from one camera position.

Earth curvature and refraction are put into the scene, not into the rays: everything sinks by (1 - k) d^2 / (2 R)
with its distance d from the eye. A straight ray through the sunk scene is the curved ray z(r) = oz + s r + (1 - k)
r^2 / (2 R) through the true one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.errors import ConfigError
from ltm_core.grid import GridGeometry
from ltm_core.simulator import noise
from ltm_core.simulator.appearance import Palette, ground_texture, palette
from ltm_core.simulator.landcover import BARE, BUILT, GRASS, SHRUB, TREE, UNLABELLED, LandCover
from ltm_core.simulator.prototypes import Prototype
from ltm_core.simulator.scenario import Scenario
from ltm_core.simulator.sky import daylight
from ltm_core.simulator.terrain import HeightField, Terrain
from ltm_core.simulator.vegetation import Planting

Array = NDArray[np.float64]

EARTH_RADIUS = 6_371_000.0  # m
REFRACTION = 0.13
_LAYERS = (BARE, BUILT, GRASS, SHRUB, TREE)  # stones lie on the ground, trees stand over all
_SITE_TEXEL, _WIDE_TEXEL = 2.0, 8.0  # m
_FLATNESS = 0.03  # m that the site's triangles may lie off its bilinear surface
_MOST_PARTS = 8  # a cell's side is cut into so many at most


def mitsuba() -> Any:
    """The renderer, set to the variant that runs everywhere. Raises ConfigError where the extra is not installed."""
    try:
        import mitsuba as mi
    except ImportError as e:
        raise ConfigError("the simulator needs Mitsuba 3: pip install 'ltm[sim]'") from e
    if mi.variant() != "scalar_rgb":
        mi.set_variant("scalar_rgb")
        mi.set_log_level(mi.LogLevel.Error)
    return mi


def _mesh(
    name: str,
    vertices: Array,
    faces: NDArray[np.uint32],
    bsdf: Any,
    colors: Array | None,
    uv: Array | None,
    normals: Array | None = None,
) -> Any:
    mi = mitsuba()
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    mesh = mi.Mesh(
        name,
        len(vertices),
        len(faces),
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=uv is not None,
        props=properties,
    )
    if colors is not None:
        mesh.add_attribute("vertex_color", 3, np.ascontiguousarray(colors, np.float32).ravel())
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(vertices, np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(faces, np.uint32).ravel()
    if normals is not None:
        parameters["vertex_normals"] = np.ascontiguousarray(normals, np.float32).ravel()
    if uv is not None:
        parameters["vertex_texcoords"] = np.ascontiguousarray(uv, np.float32).ravel()
    parameters.update()
    return mesh


def _grid_faces(keep: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Two triangles a quad of an (H, W) vertex grid, where `keep` (H-1, W-1) says so."""
    h, w = keep.shape[0] + 1, keep.shape[1] + 1
    index = np.arange(h * w, dtype=np.uint32).reshape(h, w)
    a, b, c, d = (q[keep] for q in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    return np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])


def _parts(elevation: NDArray[np.float32]) -> NDArray[np.int64]:
    """Into how many parts (H-1, W-1) a side of each quad must be cut for its triangles to follow the bilinear surface.

    Two triangles leave the bilinear surface by a quarter of the quad's twist, n^2 pairs of them by a part of n^2.
    """
    z = elevation.astype(np.float64)
    off = np.abs(z[:-1, :-1] - z[:-1, 1:] - z[1:, :-1] + z[1:, 1:]) / 4
    least = np.sqrt(np.maximum(off / _FLATNESS, 1.0))
    return np.asarray(np.minimum(2 ** np.ceil(np.log2(least)), _MOST_PARTS), np.int64)


def _cut_quads(corners: Array, parts: int, first: int) -> tuple[Array, NDArray[np.uint32]]:
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


@dataclass(frozen=True)
class View:
    """Scenes from one eye point. `layers`: (class id, UNLABELLED for the ground; scene with this and all layers before
    it)."""

    full: Any
    layers: list[tuple[int, Any]]
    sky: Any
    bend: float
    light: Any


class SceneBuilder:
    """Builds the scenes of a scenario; what does not depend on the eye (plants, textures) is made once."""

    def __init__(self, scenario: Scenario, terrain: Terrain, cover: LandCover) -> None:
        mi = mitsuba()
        self.scenario = scenario
        self.terrain = terrain
        self.cover = cover
        self.colors: Palette = palette(scenario.vegetation.green, scenario.seed)
        self.planting = Planting(terrain, cover, scenario.vegetation, self.colors, scenario.seed)
        self._leaf = mi.load_dict(
            {
                "type": "twosided",
                "b": {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}},
            }
        )
        self._groups: dict[str, Any] = {}
        self._light = {"light": mi.load_dict(daylight(scenario.sun))}
        site, wide = terrain.site.geometry, terrain.surroundings.geometry
        self._site_ground = self._ground_bsdf(
            GridGeometry(site.x_min, site.y_max, _SITE_TEXEL, *self._texels(site, _SITE_TEXEL))
        )
        self._wide_ground = self._ground_bsdf(
            GridGeometry(wide.x_min, wide.y_max, _WIDE_TEXEL, *self._texels(wide, _WIDE_TEXEL))
        )
        self._ground: list[tuple[Any, Any]] | None = None

    @staticmethod
    def _texels(geometry: GridGeometry, texel: float) -> tuple[int, int]:
        return round(geometry.width * geometry.resolution / texel), round(geometry.height * geometry.resolution / texel)

    def _ground_bsdf(self, geometry: GridGeometry) -> Any:
        mi = mitsuba()
        texture = ground_texture(self.cover, geometry, self.colors, self.scenario.vegetation.green, self.scenario.seed)
        bitmap = {
            "type": "bitmap",
            "bitmap": mi.Bitmap(texture),
            "raw": True,
            "wrap_mode": "clamp",
            "filter_type": "bilinear",
        }
        return mi.load_dict({"type": "twosided", "b": {"type": "diffuse", "reflectance": bitmap}})

    def _group(self, prototype: Prototype) -> Any:
        if prototype.name not in self._groups:
            soup = prototype.soup
            faces = np.arange(3 * len(soup.triangles), dtype=np.uint32).reshape(-1, 3)
            # One colour a triangle: Mitsuba interpolates attributes of instanced meshes with wrong weights (it takes
            # them from world points)
            colors = np.repeat(soup.colors, 3, axis=0)
            normals = np.repeat(soup.normals, 3, axis=0)
            mesh = _mesh(prototype.name, soup.triangles.reshape(-1, 3), faces, self._leaf, colors, None, normals)
            self._groups[prototype.name] = mitsuba().load_dict({"type": "shapegroup", "mesh": mesh})
        return self._groups[prototype.name]

    def _drop(self, x: Array, y: Array, eye: Array, bend: float) -> Array:
        return np.asarray(bend * ((x - eye[0]) ** 2 + (y - eye[1]) ** 2), np.float64)

    def _field_mesh(
        self,
        field: HeightField,
        keep: NDArray[np.bool_],
        bsdf: Any,
        eye: Array,
        bend: float,
        sink: float,
        parts: NDArray[np.int64] | None = None,
    ) -> Any:
        """The mesh of the quads that `keep` says, each side cut into `parts`."""
        g = field.geometry
        xs, ys = field.axes()
        x, y = np.meshgrid(xs, ys)
        z = field.elevation - self._drop(x, y, eye, bend) - sink
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
        merged = np.concatenate(vertices)
        return _mesh("ground", merged[:, :3], np.concatenate(faces), bsdf, None, merged[:, 3:])

    def _grounds(self, eye: Array, bend: float) -> list[tuple[Any, Any]]:
        """(group, instance) of the site, its surroundings and the far ranges; a group's own tree is shared by all
        scenes."""
        if self._ground is not None:
            return self._ground
        site, wide = self.terrain.site, self.terrain.surroundings
        x, y = (a for a in np.meshgrid(*wide.axes()))
        margin = 1.5 * wide.geometry.resolution
        g = site.geometry
        inside = (x > g.x_min + margin) & (x < g.x_max - margin) & (y > g.y_min + margin) & (y < g.y_max - margin)
        covered = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
        whole = np.ones((g.height - 1, g.width - 1), bool)
        meshes = [
            self._field_mesh(site, whole, self._site_ground, eye, bend, 0.0, _parts(site.elevation)),
            self._field_mesh(wide, ~covered, self._wide_ground, eye, bend, 1.5),
            self._far_ranges(eye, bend),
        ]
        out = []
        for mesh in meshes:
            group = mitsuba().load_dict({"type": "shapegroup", "mesh": mesh})
            out.append((group, mitsuba().load_dict({"type": "instance", "group": group})))
        if bend == 0.0:
            self._ground = out
        return out

    def _far_ranges(self, eye: Array, bend: float) -> Any:
        """A plain with mountain ranges from the surroundings' edge to 70 km, for the horizon."""
        wide = self.terrain.surroundings
        g = wide.geometry
        center = np.array([(g.x_min + g.x_max) / 2, (g.y_min + g.y_max) / 2])
        half = (g.x_max - g.x_min) / 2
        edge = float(np.median(np.concatenate([wide.elevation[[0, -1]].ravel(), wide.elevation[:, [0, -1]].ravel()])))
        radius = np.concatenate([[0.97 * half, 1.0 * half], np.geomspace(1.1 * half, 70_000.0, 90)])
        angle = np.linspace(0, 2 * np.pi, 721)
        # A square inner edge that follows the surroundings' border, a circle far out
        square = 1 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
        blend = np.clip((radius[:, None] - half) / (2 * half), 0, 1)
        reach = radius[:, None] * ((1 - blend) * square + blend)
        x, y = center[0] + reach * np.cos(angle), center[1] + reach * np.sin(angle)
        rise = np.clip((reach - 1.3 * half) / 16_000.0, 0, 1)
        seed = self.scenario.seed
        ridges = 1 - 2 * np.abs(noise.at_points(x.ravel(), y.ravel(), 9000.0, seed + 501)).reshape(x.shape)
        rough = noise.at_points(x.ravel(), y.ravel(), 1700.0, seed + 503).reshape(x.shape)
        z = (
            edge
            - 40.0
            + rise * (950.0 * np.clip(ridges, -0.2, 1) ** 2 + 160.0 * rough)
            + 35.0 * rough * np.clip(rise * 8, 0, 1)
        )
        z[0] = edge - 120.0
        z -= self._drop(x, y, eye, bend)
        color = 0.62 * self.colors.chamise + 0.2 * self.colors.grass + 0.18 * self.colors.soil
        tint = 1 + 0.5 * noise.at_points(x.ravel(), y.ravel(), 1500.0, seed + 507)[:, None]
        vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        return _mesh(
            "far",
            vertices,
            _grid_faces(np.ones((len(radius) - 1, len(angle) - 1), bool)),
            self._leaf,
            np.clip(color * tint, 0.02, 0.6),
            None,
        )

    def view(self, eye: Array) -> View:
        """The scenes for a camera at map point `eye` (3,)."""
        mi = mitsuba()
        bend = (1 - REFRACTION) / (2 * EARTH_RADIUS) if self.scenario.curvature else 0.0
        parts: dict[str, Any] = {}
        for i, (group, instance) in enumerate(self._grounds(eye, bend)):
            parts[f"ground_group_{i}"], parts[f"ground_{i}"] = group, instance
        layers: list[tuple[int, Any]] = [(UNLABELLED, mi.load_dict({"type": "scene", **parts}))]
        placements = self.planting.around(eye)
        transform = mi.ScalarTransform4f
        last = next((c for c in reversed(_LAYERS) if any(p.prototype.class_id == c for p in placements)), None)
        for class_id in _LAYERS:
            count = 0
            for placement in placements:
                if placement.prototype.class_id != class_id:
                    continue
                group = self._group(placement.prototype)
                parts[f"group_{placement.prototype.name}"] = group
                m = placement.transforms.copy()
                m[:, 2, 3] -= self._drop(m[:, 0, 3], m[:, 1, 3], eye, bend)
                for one in m:
                    parts[f"plant_{class_id}_{count}"] = mi.load_dict(
                        {"type": "instance", "to_world": transform(one), "group": group}
                    )
                    count += 1
            if count:
                scene = mi.load_dict({"type": "scene", **parts, **(self._light if class_id == last else {})})
                layers.append((class_id, scene))
        full = layers[-1][1] if last is not None else mi.load_dict({"type": "scene", **parts, **self._light})
        return View(full, layers, mi.load_dict({"type": "scene", **self._light}), bend, self._light["light"])
