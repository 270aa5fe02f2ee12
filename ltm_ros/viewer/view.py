"""Show the graph's results in Rerun: live on loopback, or written to an .rrd file, or both."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Lock

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from ltm_core.base.errors import ImageError, PoseError
from ltm_core.base.types import Float32Array, Int32Array, RgbImage, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pictures import MapCamera, RangeScale
from ltm_core.pictures.legend import ClassPalette
from ltm_core.pictures.maps import relief
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.surface.change import ChangeKind
from ltm_ros.viewer import fuel_maps as archetypes
from ltm_ros.viewer import scene_geometry
from ltm_ros.viewer.blueprint import TIMELINE, site_blueprint
from ltm_ros.viewer.server import GRPC_PORT, LIVE_MEMORY, WEB_PORT, RerunProcess, grpc_url, web_url

MAX_POINTS = 15_000
"""Maximum points of one depth image in the 3D view."""
RELIEF_PIXELS = 2048
"""Longer side of the relief under the fuel grid in pixels."""
CAMERA_COLOR = (235, 40, 135)
NAME_COLOR = (255, 225, 240)
"""The viewer writes a label in its point's colour on dark grey, where camera colours would be unreadable."""


class RerunView:
    """One site in Rerun; thread-safe.

    `save`: .rrd file to write; `serve`: a web viewer on loopback at `web_port`, fed from `grpc_port`. Stamps are
    nanoseconds. Raises ConfigError if a port is in use."""

    def __init__(
        self,
        application_id: str,
        site: Site,
        dem: Dem,
        label_set: ClassPalette,
        *,
        save: Path | None = None,
        serve: bool = False,
        web_port: int = WEB_PORT,
        grpc_port: int = GRPC_PORT,
    ) -> None:
        self._site, self._dem, self._palette = site, dem, label_set
        self._lock = Lock()
        self._scale = RangeScale()
        g = dem.geometry
        self._reach = min(site.fuel.max_range, max(g.shape) * g.resolution)
        self._cameras: dict[str, MapCamera] = {}
        self._poses: dict[str, Pose] = {}
        self._shown: set[str] = set()
        self._undated: dict[str, Callable[[int], None]] = {}
        """What waits for the first stamp of the time line."""
        self._live = serve
        self._server = RerunProcess.serve(web_port, grpc_port, memory_limit=LIVE_MEMORY) if serve else None
        self.url = web_url(web_port, grpc_port) if serve else None
        self._recording = rr.RecordingStream(application_id)
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if save is not None:
            save.parent.mkdir(parents=True, exist_ok=True)
            sinks.append(rr.FileSink(save))
        if serve:
            sinks.append(rr.GrpcSink(grpc_url(grpc_port)))
        for name, config in site.cameras.items():
            # A camera whose pose or calibration is a topic is placed at its first message.
            if config.pose and config.calibration:
                with contextlib.suppress(PoseError):
                    self._place(name, config.pose.pose(dem, site.frame), config.calibration.camera())
        self._fuel = scene_geometry.FuelLayer(dem, site.fuel_geometry(dem), label_set)
        self._fuel_geometry = site.fuel_geometry(dem)
        self._changed: dict[tuple[int, int], tuple[float, float, float, int]] = {}
        """Places and kinds of the changed cells so far, by row and col."""
        if sinks:
            self._recording.set_sinks(*sinks, default_blueprint=self._blueprint())
        self._log_scene()

    def log_image(self, camera: str, stamp_ns: int, rgb: RgbImage) -> None:
        """Log the camera's image, (H, W, 3) uint8."""
        with self._at(stamp_ns) as log:
            log(f"map/cameras/{camera}/photo", archetypes.jpeg(archetypes.shrunk(rgb, cv2.INTER_AREA), 80))

    def log_depth(self, camera: str, stamp_ns: int, depth: Float32Array, model: Camera) -> None:
        """Log depth (H, W), metres; +inf sky, NaN unknown. Raises ImageError for another size."""
        if depth.shape != (model.height, model.width):
            raise ImageError(f"depth of {camera} is {depth.shape}, its calibration {model.height} x {model.width}")
        with self._at(stamp_ns) as log:
            log(f"depth/{camera}", archetypes.depth_picture(depth, self._scale))

    def log_fusion(
        self, camera: str, stamp_ns: int, fused: Float32Array, traced: Float32Array, network: Float32Array | None = None
    ) -> None:
        """Log fused, traced and network's depth, each (H, W) along the optical axis in metres; the network's may be of
        another size. Raises ImageError if fused and traced differ in size."""
        if fused.shape != traced.shape:
            raise ImageError(f"fused depth of {camera} is {fused.shape}, its traced depth {traced.shape}")
        with self._at(stamp_ns) as log:
            log(f"fusion/{camera}/traced", archetypes.depth_picture(traced, self._scale))
            log(f"fusion/{camera}/fused", archetypes.depth_picture(fused, self._scale))
            log(f"fusion/{camera}/difference", archetypes.difference_picture(fused, traced))
            if network is not None:
                # At the size of the others, so that all are side by side.
                grown = np.asarray(cv2.resize(network, fused.shape[::-1], interpolation=cv2.INTER_NEAREST), np.float32)
                log(f"fusion/{camera}/network", archetypes.depth_picture(grown, self._scale))

    def log_labels(self, camera: str, stamp_ns: int, labels: UInt8Array) -> None:
        """Log class ids (H, W) uint8, 255 unlabelled, of the size of the image."""
        with self._at(stamp_ns) as log:
            shown = archetypes.shrunk(labels, cv2.INTER_NEAREST)
            log(f"map/cameras/{camera}/labels", rr.SegmentationImage(shown, opacity=0.55, draw_order=1.0))

    def log_heat(self, camera: str, stamp_ns: int, heat: UInt8Array) -> None:
        """Log the probability of a prompt (H, W) uint8, of the size of the image."""
        with self._at(stamp_ns) as log:
            log(f"map/cameras/{camera}/heat", archetypes.heat_image(heat))

    def log_pose(self, camera: str, stamp_ns: int, pose: Pose, model: Camera) -> None:
        """Log the camera's pose. Without one in the site file, the first pose moves the view there."""
        with self._at(stamp_ns) as log:
            place = rr.Transform3D(translation=pose.position, mat3x3=pose.rotation)
            axes = rr.TransformAxes3D(0.0)  # else the viewer draws arrows
            log(f"map/cameras/{camera}", place, axes, archetypes.pinhole(model, self._reach * 0.15))
            expected = self._poses.get(camera)
            if camera not in self._shown or expected != pose:
                self._shown.add(camera)
                self._place(camera, pose, model)
                self._log_on_map(camera)
                # The camera's own entity shows only the frustum.
                radii = rr.Radius.ui_points(4.0)
                name = rr.Points3D([pose.position], labels=[camera], colors=[NAME_COLOR], radii=radii)
                log(f"map/names/{camera}", name)
            if expected is None:
                self._recording.send_blueprint(self._blueprint())

    def log_points(
        self, camera: str, stamp_ns: int, points: NDArray[np.floating], colors: UInt8Array | None = None
    ) -> None:
        """Log points (N, 3) that the camera sees, map frame, with colours (N, 3); thinned to `MAX_POINTS`."""
        kept = scene_geometry.thinned(points, MAX_POINTS)
        shown = None if colors is None else colors[kept]
        with self._at(stamp_ns) as log:
            place = points[kept].astype(np.float32)
            log(f"map/points/{camera}", rr.Points3D(place, colors=shown, radii=rr.Radius.ui_points(1.5)))

    def log_fuel_map(self, stamp_ns: int, classes: UInt8Array, geometry: GridGeometry) -> None:
        """Log the fuel map (H, W) of class ids, 255 not seen, map frame. Without evidence it has stamp 0, and is shown
        from the first frame on. Raises RasterError if shapes differ."""
        if not stamp_ns:
            self._undated["map"] = lambda first_ns: self.log_fuel_map(first_ns, classes, geometry)
            return
        with self._at(stamp_ns) as log:
            if geometry != self._fuel_geometry:
                self._fuel_geometry = geometry
                self._fuel = scene_geometry.FuelLayer(self._dem, geometry, self._palette)
                self._log_relief()
                log("map/fuel", rr.Clear(recursive=True))
                for name in self._shown:
                    self._log_on_map(name)
            changed = dict(self._fuel.changed(classes))
            for name, parts in changed.items():
                tile = rr.Mesh3D(**parts, albedo_factor=(255, 255, 255, 200))
                log(f"map/fuel/{name}", tile if len(parts["triangle_indices"]) else rr.Clear(recursive=False))
            if changed:
                log("fuel_map/classes", rr.SegmentationImage(classes, opacity=0.7, draw_order=1.0))

    def log_change(self, stamp_ns: int, kinds: UInt8Array, geometry: GridGeometry) -> None:
        """Log kinds of change (H, W) of a window of the terrain's grid, 255 not observed, map frame."""
        with self._at(stamp_ns) as log:
            log("terrain/change", *archetypes.change_picture(kinds, geometry, self._fuel_geometry))

    def log_changed_cells(self, stamp_ns: int, cells: Int32Array, points: Float32Array, kinds: UInt8Array) -> None:
        """Log cells (N, 2) row, col of the terrain's grid whose kind of change (N,) is new, at points (N, 3)."""
        with self._at(stamp_ns) as log:
            for (row, col), place, kind in zip(cells.tolist(), points.tolist(), kinds.tolist(), strict=True):
                if kind == ChangeKind.NONE:
                    self._changed.pop((row, col), None)
                else:
                    self._changed[row, col] = (*place, kind)
            log("map/change", archetypes.changed_points(self._changed.values()))

    def close(self) -> None:
        """Write what is pending, finish the file, end the server."""
        if self._undated:  # no frame has come, but the map is known
            with self._at(1):
                pass
        with self._lock:
            self._recording.flush()
            self._recording.disconnect()
            if self._server is not None:
                self._server.stop()

    @contextlib.contextmanager
    def _at(self, stamp_ns: int) -> Iterator[Callable[..., None]]:
        """Set the time of what is logged in the block."""
        undated, self._undated = self._undated, {}
        for log in undated.values():
            log(stamp_ns)
        with self._lock:
            self._recording.set_time(TIMELINE, timestamp=np.datetime64(stamp_ns, "ns"))
            yield self._recording.log

    def _place(self, camera: str, pose: Pose, model: Camera) -> None:
        x, y, _ = pose.position
        self._poses[camera] = pose
        self._cameras[camera] = MapCamera(camera, model, (float(x), float(y)), pose.angles_deg[0], self._reach)

    def _blueprint(self) -> object:
        names = list(self._site.cameras) + [name for name in self._cameras if name not in self._site.cameras]
        poses = [self._poses[name] for name in self._cameras]
        positions = np.array([pose.position for pose in poses]).reshape(-1, 3)
        azimuths = np.array([pose.angles_deg[0] for pose in poses])
        eye = scene_geometry.overview_eye(self._dem, positions, azimuths, self._reach * 0.6)
        site = self._site
        tabs = bool(site.depth_model), bool(site.vocabulary), site.terrain is not None
        return site_blueprint(names, eye, self._window(), self._live, *tabs)

    def _window(self) -> rrb.VisualBounds2D:
        """Return a window around the cameras and the ground before them, within the fuel grid."""
        g = self._fuel_geometry
        outline = [camera.sector() for camera in self._cameras.values()]
        corners = np.vstack(outline) if outline else np.array([[g.x_min, g.y_min], [g.x_max, g.y_max]])
        row, col = g.to_grid(corners[:, 0].clip(g.x_min, g.x_max), corners[:, 1].clip(g.y_min, g.y_max))
        margin = 0.06 * max(np.ptp(row), np.ptp(col))
        columns, rows = ((float(part.min() - margin), float(part.max() + margin)) for part in (col, row))
        return rrb.VisualBounds2D(x_range=columns, y_range=rows)

    def _log_scene(self) -> None:
        with self._lock:
            log = self._recording
            log.log("/", archetypes.annotation_context(self._palette), static=True)
            log.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            log.log("map/terrain", rr.Mesh3D(**scene_geometry.terrain_mesh(self._dem)), static=True)
            log.log("legend", archetypes.legend(self._palette, self._fuel_geometry.resolution), static=True)
            self._log_relief()
            if self._site.terrain is not None:
                log.log("terrain", archetypes.change_classes(), static=True)

    def _log_relief(self) -> None:
        """Log the relief under the fuel grid, finer than the cells, in units of cells."""
        g = self._fuel_geometry
        finer = max(1, RELIEF_PIXELS // max(g.shape))
        view = GridGeometry(g.x_min, g.y_max, g.resolution / finer, g.width * finer, g.height * finer, g.crs)
        picture = relief(self._dem, view)
        shrink = RELIEF_PIXELS / max(picture.shape[:2])
        if shrink < 1:
            size = round(picture.shape[1] * shrink), round(picture.shape[0] * shrink)
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
        self._recording.log(
            "fuel_map/relief",
            rr.Transform3D(scale=(g.width / picture.shape[1], g.height / picture.shape[0], 1.0)),
            archetypes.jpeg(picture, 88, draw_order=-1.0),
            static=True,
        )

    def _log_on_map(self, camera: str) -> None:
        """Log the camera's place and sector on the fuel grid."""
        placed = self._cameras[camera]
        row, col = self._fuel_geometry.to_grid(placed.sector()[:, 0], placed.sector()[:, 1])
        outline = np.column_stack([col, row]) + 0.5
        log, points, entity = self._recording.log, rr.Radius.ui_points, f"fuel_map/cameras/{camera}"
        log(f"{entity}/sector", rr.LineStrips2D([outline], colors=[CAMERA_COLOR], radii=points(1.0), draw_order=2.0))
        place, name = {"positions": outline[:1], "draw_order": 3.0}, {"labels": [camera], "colors": [NAME_COLOR]}
        log(entity, rr.Points2D(**place, colors=[CAMERA_COLOR], radii=points(6.0)))
        log(f"{entity}/name", rr.Points2D(**place | name | {"draw_order": 4.0}, radii=points(2.5)))
