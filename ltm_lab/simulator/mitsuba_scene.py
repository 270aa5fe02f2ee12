"""Builds the Mitsuba scene that is seen from one camera position.

Earth curvature and refraction are put into the scene, not into the rays: everything sinks by (1 - k) d^2 / (2 R)
with its distance d from the eye. A straight ray through the sunk scene is the curved ray z(r) = oz + s r + (1 - k)
r^2 / (2 R) through the true one.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float64Array, UInt32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator.appearance import Reflectances, ground_texture, palette
from ltm_lab.simulator.ground_mesh import Triangles, far_ranges, field_triangles, seen_from, twist_parts, under
from ltm_lab.simulator.landcover import BARE, BUILT, GRASS, SHRUB, TREE, LandCover
from ltm_lab.simulator.prototypes import Prototype
from ltm_lab.simulator.scenario import Scenario
from ltm_lab.simulator.terrain_synthesis import SyntheticTerrain
from ltm_lab.simulator.vegetation import Placement, Planting

EARTH_RADIUS = 6_371_000.0  # m
REFRACTION = 0.13
_KINDS = (BARE, BUILT, GRASS, SHRUB, TREE)
_SITE_TEXEL, _WIDE_TEXEL = 2.0, 8.0  # m
SURROUNDINGS_SINK = 1.5  # m, so that they stay under the site along its border


def mitsuba() -> Any:
    """The renderer, set to the variant that runs everywhere. Raises ConfigError where the extra is not installed."""
    try:
        import mitsuba as mi
    except ImportError as e:
        raise ConfigError("the simulator needs Mitsuba 3: pip install './ltm_lab[sim]'") from e
    if mi.variant() != "scalar_rgb":
        mi.set_variant("scalar_rgb")
        mi.set_log_level(mi.LogLevel.Error)
    return mi


def _mesh(
    name: str,
    vertices: NDArray[Any],
    faces: UInt32Array,
    bsdf: Any,
    colors: NDArray[Any] | None,
    uv: NDArray[Any] | None,
    normals: Float64Array | None = None,
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


@dataclass(frozen=True)
class EyePointScenes:
    """Scenes from one eye point: `full` with its light, `ground` alone, and `kinds` of plants each alone by class id.

    `instances`: how many stand in `full`, `near` of them within the detail radius or grown tree by tree.
    """

    full: Any
    ground: Any
    kinds: list[tuple[int, Any]]
    sky: Any
    bend: float
    light: Any
    instances: int
    near: int


class SceneBuilder:
    """Builds the scenes of a scenario; what does not depend on the eye (plants, textures) is made once."""

    def __init__(self, scenario: Scenario, terrain: SyntheticTerrain, cover: LandCover) -> None:
        mi = mitsuba()
        self.scenario = scenario
        self.terrain = terrain
        self.cover = cover
        self.colors: Reflectances = palette(scenario.vegetation.green, scenario.seed)
        self.planting = Planting(terrain, cover, scenario.vegetation, self.colors, scenario.seed)
        self._leaf = mi.load_dict(
            {
                "type": "twosided",
                "b": {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}},
            }
        )
        self._groups: dict[str, Any] = {}
        azimuth, elevation = np.radians(scenario.sun.azimuth_deg), np.radians(scenario.sun.elevation_deg)
        flat = np.cos(elevation)
        # A clear sky with its sun (Hosek & Wilkie 2012), black below the horizon
        daylight = {
            "type": "sunsky",
            "turbidity": scenario.sun.turbidity,
            "sun_direction": [float(v) for v in (np.sin(azimuth) * flat, np.cos(azimuth) * flat, np.sin(elevation))],
            "albedo": 0.2,
        }
        self._light = {"light": mi.load_dict(daylight)}
        site, wide = terrain.site.geometry, terrain.surroundings.geometry
        self._site_ground = self._ground_bsdf(site, _SITE_TEXEL)
        self._wide_ground = self._ground_bsdf(wide, _WIDE_TEXEL)
        self._bend = (1 - REFRACTION) / (2 * EARTH_RADIUS) if scenario.curvature else 0.0
        self._center = np.array([(site.x_min + site.x_max) / 2, (site.y_min + site.y_max) / 2])
        self._ground = self._ground_groups()

    def _ground_bsdf(self, over: GridGeometry, texel: float) -> Any:
        mi = mitsuba()
        width, height = (round(n * over.resolution / texel) for n in (over.width, over.height))
        geometry = GridGeometry(over.x_min, over.y_max, texel, width, height)
        texture = ground_texture(self.cover, geometry, self.colors, self.scenario.seed)
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

    def _ground_groups(self) -> list[Any]:
        """The site, its surroundings and the far ranges, sunk about the site's middle."""
        site, wide = self.terrain.site, self.terrain.surroundings
        center, bend = self._center, self._bend
        whole = np.ones((site.geometry.height - 1, site.geometry.width - 1), bool)
        pieces: list[tuple[Triangles, Any]] = [
            (field_triangles(site, whole, center, bend, parts=twist_parts(site.elevation)), self._site_ground),
            (field_triangles(wide, ~under(wide, site), center, bend, sink=SURROUNDINGS_SINK), self._wide_ground),
        ]
        far = self.terrain.far
        if far is None:
            pieces.append((far_ranges(wide, self.colors, self.scenario.seed, center, bend), self._leaf))
        else:
            beyond = field_triangles(far, ~under(far, wide), center, bend, sink=2 * SURROUNDINGS_SINK)
            pieces.append((beyond, self._ground_bsdf(far.geometry, far.geometry.resolution)))
        groups = []
        for triangles, bsdf in pieces:
            mesh = _mesh("ground", triangles.vertices, triangles.faces, bsdf, triangles.colors, triangles.uv)
            groups.append(mitsuba().load_dict({"type": "shapegroup", "mesh": mesh}))
        return groups

    def _grounds(self, eye: Float64Array) -> dict[str, Any]:
        """The ground as `eye` sees x."""
        mi = mitsuba()
        turned = mi.ScalarTransform4f(seen_from(eye, self._center, self._bend))
        parts: dict[str, Any] = {}
        for i, group in enumerate(self._ground):
            parts[f"ground_group_{i}"] = group
            parts[f"ground_{i}"] = mi.load_dict({"type": "instance", "to_world": turned, "group": group})
        return parts

    def _plants(self, placements: list[Placement], eye: Float64Array) -> dict[str, Any]:
        mi = mitsuba()
        transform = mi.ScalarTransform4f
        parts: dict[str, Any] = {}
        for placement in placements:
            name = placement.prototype.name
            group = self._group(placement.prototype)
            parts[f"group_{name}"] = group
            m = placement.transforms.copy()
            m[:, 2, 3] -= self._bend * ((m[:, :2, 3] - eye[:2]) ** 2).sum(axis=1)
            for i, one in enumerate(m):
                parts[f"{name}_{i}"] = mi.load_dict({"type": "instance", "to_world": transform(one), "group": group})
        return parts

    def view(self, eye: Float64Array) -> EyePointScenes:
        """The scenes for a camera at map point `eye` (3,)."""
        mi = mitsuba()
        ground = self._grounds(eye)
        placements = self.planting.around(eye, self._bend)
        kinds, everything = [], dict(ground)
        for class_id in _KINDS:
            parts = self._plants([p for p in placements if p.prototype.class_id == class_id], eye)
            if parts:
                everything |= parts
                kinds.append((class_id, mi.load_dict({"type": "scene", **parts})))
        near = sum(len(p.transforms) for p in placements if not p.prototype.name.startswith(("far_", "lone_")))
        return EyePointScenes(
            mi.load_dict({"type": "scene", **everything, **self._light}),
            mi.load_dict({"type": "scene", **ground}),
            kinds,
            mi.load_dict({"type": "scene", **self._light}),
            self._bend,
            self._light["light"],
            sum(len(p.transforms) for p in placements),
            near,
        )
