"""The ray tracers that `ltm-lab bench trace` compares with ours: each is set up over a DEM and traces a view.

The rays of the peers are made and rotated beforehand, which is not counted; ours starts from a camera and a pose. The
mesh peers trace two triangles per cell and a flat earth.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ltm_core.base.types import Float32Array, Float64Array, Int32Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_lab.tracers.march import march


@dataclass(frozen=True)
class TracedView:
    """A camera at a pose."""

    camera: Camera
    pose: Pose

    def rays(self) -> Float64Array:
        """Return (N, 3) unit vectors in the map frame, row by row."""
        return np.ascontiguousarray((self.camera.rays() @ self.pose.rotation.T).reshape(-1, 3))


class Peer(Protocol):
    """A tracer set up over a DEM."""

    def prepare(self, view: TracedView) -> Callable[[], Any]:
        """Make the rays of a view and return a call that traces them."""
        ...


class Embreex:
    """Embree 4 through embreex, single-threaded as it is shipped."""

    def __init__(self, dem: Dem) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        vertices, faces = triangles(dem)
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, vertices, faces)

    def prepare(self, view: TracedView) -> Callable[[], Any]:
        rays = view.rays().astype(np.float32)
        origins = np.broadcast_to(view.pose.position.astype(np.float32), rays.shape).copy()
        return lambda: self._scene.run(origins, rays, query="DISTANCE")


class Mitsuba:
    """Mitsuba 3's LLVM variant: vector packets of coherent rays through Embree 4, all cores."""

    def __init__(self, dem: Dem) -> None:
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        mi.set_log_level(mi.LogLevel.Error)
        vertices, faces = triangles(dem)
        mesh = mi.Mesh("terrain", len(vertices), len(faces), has_vertex_normals=False, has_vertex_texcoords=False)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = vertices.ravel()
        parameters["faces"] = faces.astype(np.uint32).ravel()
        parameters.update()
        self._scene = mi.load_dict({"type": "scene", "terrain": mesh})

    def prepare(self, view: TracedView) -> Callable[[], Any]:
        import drjit as dr
        import mitsuba as mi

        origin = mi.Point3f(*(float(v) for v in view.pose.position))
        rays = mi.Vector3f(np.ascontiguousarray(view.rays().T, np.float32))
        dr.eval(rays)

        def trace() -> Any:
            hit = self._scene.ray_intersect_preliminary(mi.Ray3f(origin, rays), coherent=True)
            return np.array(hit.t)  # waits for the kernel

        return trace


class March:
    """The paper's march in steps of 1 m, compiled, all cores; it traces only some rays, because all take minutes."""

    def __init__(self, dem: Dem) -> None:
        self._dem = dem

    def prepare(self, view: TracedView) -> Callable[[], Any]:
        rays = view.rays()
        march(self._dem, view.pose.position, rays[:8])  # compiles
        return lambda: march(self._dem, view.pose.position, rays, step=1.0)


def triangles(dem: Dem) -> tuple[Float32Array, Int32Array]:
    """Return vertices (H * W, 3) at the cell centres, and faces (M, 3), two between every four vertices."""
    height, width = dem.elevation.shape
    x = np.asarray(dem.geometry.to_map(0, np.arange(width))[0], np.float32)
    y = np.asarray(dem.geometry.to_map(np.arange(height), 0)[1], np.float32)
    vertices = np.empty((height, width, 3), np.float32)
    vertices[..., 0], vertices[..., 1], vertices[..., 2] = x, y[:, None], dem.elevation
    corner = np.arange(height * width, dtype=np.int32).reshape(height, width)[:-1, :-1]
    faces = np.empty((height - 1, width - 1, 2, 3), np.int32)
    for k, offset in enumerate((0, width, 1)):
        faces[..., 0, k] = corner + offset
    for k, offset in enumerate((1, width, width + 1)):
        faces[..., 1, k] = corner + offset
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


@dataclass(frozen=True)
class PeerKind:
    """A peer before it is set up.

    `bytes_per_cell` is the memory that its set-up needs; it is skipped if less is free. It traces every `every`-th
    pixel of every `every`-th row, and its cost is scaled up.
    """

    name: str
    module: str
    make: Callable[[Dem], Peer]
    bytes_per_cell: int
    every: int = 1

    @property
    def installed(self) -> bool:
        """Return whether its package can be imported."""
        return importlib.util.find_spec(self.module) is not None


PEERS = (
    PeerKind("embreex", "embreex", Embreex, 340),
    PeerKind("mitsuba", "mitsuba", Mitsuba, 340),
    PeerKind("march", "numba", March, 4, every=8),
)
