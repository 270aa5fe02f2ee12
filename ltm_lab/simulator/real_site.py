"""The ground and the vegetation of a real site, from its own DEM and fuel map, for rendering what its cameras see.

Round a camera the ground is that of the finest raster, farther out a coarser one, and beyond that the horizon. The fuel
map says which vegetation stands where, not how single plants do: their places are drawn.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from PIL import Image
from scipy import ndimage

from ltm_core.base.errors import ConfigError, Findings
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.fuel.life_form import NODATA, forms_of
from ltm_core.fuel.prior import load_prior
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.site.camera_check import check_camera
from ltm_core.site.site import Site
from ltm_core.visibility.viewshed import PosedCamera
from ltm_lab.simulator.camera_setup import ImagingConfig, ViewsConfig
from ltm_lab.simulator.landcover import SHRUB, LandCover, Stand
from ltm_lab.simulator.run import Shot, SimulatedSite
from ltm_lab.simulator.scenario import Scenario
from ltm_lab.simulator.terrain_synthesis import HeightField, SyntheticTerrain
from ltm_lab.simulator.viewpoints import Report
from ltm_lab.simulator.works import Houses

_SIDES = ((4_000.0, 4.0), (12_000.0, 16.0), (80_000.0, 90.0))
"""Side and least cell size in metres of the ground near a camera, around it, and out to the horizon."""
_CLEAR_M = 15.0
"""Radius in metres around a camera within which no plants are drawn; they would hide the view."""
_WIDEST = 960
"""Maximum width of a rendered image in pixels; metrics compare squares of 256 and 299 pixels."""


def scenario_of(site: Site, samples: int) -> Scenario:
    """Return the scenario with which a site is rendered: its frame, and the simulator's usual light and air."""
    return Scenario(
        name=site.name, seed=0, crs=site.crs, origin=site.origin, curvature=site.curvature,
        imaging=ImagingConfig(samples=samples), views=ViewsConfig(),
    )  # fmt: skip


def views_of(site: Site, dem: Dem) -> list[PosedCamera]:
    """Return the views of the cameras whose pose and calibration are in the site file. Raises ConfigError if there are
    none."""
    views: list[PosedCamera] = []
    for name in site.cameras:
        check_camera(Findings(), name, site, dem, views)
    if not views:
        raise ConfigError(f"site {site.name}: no camera has a pose and a calibration in the site file; give them")
    return views


def simulated_site(site: Site, dem: Dem, eye: Float64Array) -> SimulatedSite:
    """Return the ground and the vegetation round a camera at `eye` (map frame). Raises RasterError as the prior does,
    ConfigError for a camera without terrain."""
    near, around, far = (_field(dem, eye, side, least) for side, least in _SIDES)
    wetness = np.zeros(around.geometry.shape, np.float32)
    return SimulatedSite(SyntheticTerrain(near, around, wetness, far), _cover(site, around, eye))


def _field(dem: Dem, eye: Float64Array, side: float, least: float) -> HeightField:
    size = max(least, dem.geometry.resolution)
    cells = round(side / size)
    x, y = (math.floor(v / size) * size for v in eye[:2])
    geometry = GridGeometry(x - cells // 2 * size, y + cells // 2 * size, size, cells, cells)
    rows, cols = np.mgrid[:cells, :cells]
    heights = np.asarray(dem.elevation_at(*geometry.to_map(rows, cols)), np.float32)
    unknown = ~np.isfinite(heights)
    if unknown.all():
        raise ConfigError(f"no terrain around the camera at ({eye[0]:.0f}, {eye[1]:.0f}) in the map frame")
    heights[unknown] = np.nanmin(heights)  # a plain that hides nothing
    return HeightField(heights, geometry)


def _cover(site: Site, ground: HeightField, eye: Float64Array) -> LandCover:
    """Return the land cover over a field, by the site's fuel map; shrubs where it has none, no plants at the camera."""
    over = ground.geometry
    fine = GridGeometry(over.x_min, over.y_max, over.resolution / 2, 2 * over.width, 2 * over.height)
    classes = np.full(fine.shape, SHRUB, np.uint8)
    if site.fuel.prior is not None:
        x0, y0 = site.origin
        bounds = over.translated(x0, y0).bounds
        cells = GridGeometry.snapped(bounds, site.fuel.resolution, site.fuel.phase, site.crs)
        prior = load_prior(site.fuel.prior, cells)
        first = forms_of(prior.codes).argmax(axis=-1) + 1
        form = np.where(prior.codes == NODATA, SHRUB, first).astype(np.uint8)
        rows, cols = site.in_map(cells).cell_of(*fine.to_map(*np.mgrid[: fine.height, : fine.width]))
        classes = form[np.clip(rows, 0, cells.height - 1), np.clip(cols, 0, cells.width - 1)]
    smooth = HeightField(ndimage.gaussian_filter(ground.elevation, 2.0), over)
    east, north = (ndimage.zoom(slope, 2, order=1, mode="nearest", grid_mode=True) for slope in smooth.gradient())
    exposure = np.clip(2 * north, -1, 1).astype(np.float32)  # ground that rises to the north faces south
    moisture = np.clip(-exposure - 0.2 * np.abs(east), -1, 1).astype(np.float32)
    stand = Stand.undisturbed(fine.shape)
    x, y = fine.to_map(*np.mgrid[: fine.height, : fine.width])
    stand.density[np.hypot(x - eye[0], y - eye[1]) < _CLEAR_M] = 0.0
    return LandCover(classes, np.zeros(fine.shape, bool), moisture, exposure, fine, stand, Houses.none())


@dataclass(frozen=True, eq=False)
class Rendered:
    """An image to render: its name, the camera of the view, and the frame without the camera's distortion, at most
    `_WIDEST` pixels wide."""

    name: str
    camera: Camera
    shot: Shot

    @classmethod
    def of(cls, name: str, view: PosedCamera, dem: Dem) -> "Rendered":
        """Return the image of a view. Raises ConfigError for a camera without terrain or under it."""
        share = min(1.0, _WIDEST / view.camera.width)
        pinhole = replace(view.camera, distortion=(0.0,) * 5)
        camera = pinhole.resized(round(view.camera.width * share), round(view.camera.height * share))
        camera = replace(camera, fy=camera.fx * pinhole.fy / pinhole.fx)  # rows are rounded, pixels stay square
        mast = float(view.pose.position[2] - dem.elevation_at(*view.pose.position[:2]))
        return cls(name, view.camera, Shot(view.name, camera, view.pose, 0, mast, "now", Report.exact(view.pose, 0)))

    @property
    def place(self) -> tuple[float, ...]:
        return tuple(float(v) for v in self.shot.pose.position)

    def like(self, photo: UInt8Array) -> Image.Image:
        """Return a photo as the rendered image's camera would take it: without distortion, at its size. Raises
        ConfigError for another shape."""
        (height, width), camera = photo.shape[:2], self.shot.camera
        if abs(width * camera.height - height * camera.width) > width + height:
            raise ConfigError(
                f"{self.name}: the photo has {width} x {height} pixels, which is not the shape of its calibration; "
                "correct `calibration` of the camera"
            )
        if any(self.camera.distortion):
            lens = self.camera.resized(width, height)
            matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
            photo = np.asarray(cv2.undistort(photo, matrix, np.array(lens.distortion)), np.uint8)
        kernel = Image.Resampling.BOX if width > camera.width else Image.Resampling.BICUBIC
        return Image.fromarray(photo).resize((camera.width, camera.height), kernel)
