"""Pictures of the trials' cameras, and the poses that are found in them: the fuel map with refined poses.

The pictures are drawn, not rendered: ground coloured by its plants, shaded by its slopes and hazier the farther it is.
What stands on the ground and the error of the DEM are in them, and not in the DEM that the search has: skylines lie
higher than it says, by plants whose heights differ from cell to cell. The search is the system's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.fuel.life_form import LifeForm
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain, find_pose
from ltm_core.pose_estimation.skyline.picture_evidence import picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.picture_pose_io import result_of
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.holes import NOTHING_BEYOND
from ltm_core.vision.labels import Label
from ltm_lab.evaluation.fuel.trial_country import CAMERA, SUBCELLS, World

_PLANTS = {LifeForm.GRASS: (0.4, 0.2), LifeForm.SHRUB: (1.5, 0.7), LifeForm.TREE: (7.0, 3.0), LifeForm.BARE: (0.0, 0.1)}
"""Metres that stand over a cell of the DEM, and their standard deviation from cell to cell."""
_COLOURS = {
    LifeForm.GRASS: (150, 140, 90),
    LifeForm.SHRUB: (95, 105, 70),
    LifeForm.TREE: (50, 70, 45),
    LifeForm.BARE: (165, 150, 135),
}
_SKY, _HAZE = (195, 212, 235), (165, 180, 198)
_VISIBILITY = 9000.0
"""Metres at which haze leaves 1/e of the ground's own colour."""
_GRAIN = 3.0
"""Standard deviation of a pixel's noise, 8-bit steps."""
_DEM_ERROR, _DEM_ERROR_CELLS = 0.7, 3.0
"""Metres, standard deviation, and the cells over which it is alike."""
_CLEARING = 40.0
"""Metres about a camera without plants: a low one among trees would stand in one."""


class TrialPictures:
    """Draws what a camera at a true pose sees of `world`, and finds its pose in that. `cameras`: their places, about
    which nothing stands."""

    def __init__(
        self,
        world: World,
        bend: float,
        rng: np.random.Generator,
        cameras: Sequence[tuple[float, float, float]],
    ) -> None:
        self._fine, self._rng, self._config = world.fine, rng, PicturePoseConfig()
        self._terrain = SearchTerrain(world.dem, bend, NOTHING_BEYOND)
        cell = world.geometry.resolution / SUBCELLS
        rows, cols = world.fine.shape
        self._cells = GridGeometry(world.geometry.x_min, world.geometry.y_max, cell, cols, rows)
        self._surface = self._with_plants(world, cameras)
        self._tracer = TerrainTracer(self._surface, possible=NOTHING_BEYOND)

    def refined(self, believed: Pose, true: Pose, sigma_deg: float, land: UInt8Array) -> tuple[Pose, Float64Array]:
        """The pose that a picture from `true` shows, and its (6, 6) covariance; as believed where it shows none.

        `sigma_deg`: of each believed angle. `land`: (H, W) labels that a network gives to the ground.
        """
        prior = PosePrior(believed, sigma_deg, sigma_deg, sigma_deg)
        photo, sky = self._photo(true)
        labels = np.where(sky, np.uint8(Label.SKY), np.where(land == Label.SKY, np.uint8(Label.BARE), land))
        search = find_pose(picture_evidence(photo, labels, CAMERA, self._config), self._terrain, prior, self._config)
        found = result_of(search, prior, CAMERA)
        return found.pose, found.covariance

    def _with_plants(self, world: World, cameras: Sequence[tuple[float, float, float]]) -> Dem:
        """The DEM with its error and what stands on it, on its own cells."""
        dem = world.dem
        error = ndimage.gaussian_filter(self._rng.standard_normal(dem.elevation.shape), _DEM_ERROR_CELLS)
        x, y = dem.geometry.to_map(*np.indices(dem.elevation.shape))
        row, col = self._cells.cell_of(x, y)
        inside = self._cells.contains(row, col)
        forms = np.where(inside, self._fine[np.where(inside, row, 0), np.where(inside, col, 0)], LifeForm.BARE)
        for camera in cameras:
            forms[np.hypot(x - camera[0], y - camera[1]) < _CLEARING] = LifeForm.BARE
        height = self._rng.standard_normal(forms.shape)
        for form, (mean, sigma) in _PLANTS.items():
            height = np.where(forms == form, np.maximum(mean + sigma * height, 0.0), height)
        raised = dem.elevation + _DEM_ERROR * error / error.std() + height
        return Dem(raised.astype(np.float32), dem.geometry)

    def _photo(self, pose: Pose) -> tuple[UInt8Array, BoolArray]:
        """(H, W, 3) RGB, and (H, W) where it shows sky."""
        shown = self._tracer.trace(CAMERA, pose)
        sky = ~np.isfinite(shown.range)
        points = shown.points()
        x, y = np.where(sky, 0.0, points[..., 0]), np.where(sky, 0.0, points[..., 1])
        row, col = self._cells.cell_of(x, y)
        inside = self._cells.contains(row, col)
        forms = np.where(inside, self._fine[np.where(inside, row, 0), np.where(inside, col, 0)], LifeForm.BARE)
        colours = np.zeros((256, 3))
        for form, colour in _COLOURS.items():
            colours[form] = colour
        ground = colours[forms] * self._light(x, y)[..., None]
        clear = np.exp(-np.where(sky, 0.0, shown.range) / _VISIBILITY)[..., None]
        photo = np.where(sky[..., None], _SKY, ground * clear + np.array(_HAZE) * (1 - clear))
        photo = cv2.GaussianBlur(photo, (0, 0), 0.6) + _GRAIN * self._rng.standard_normal(photo.shape)
        return np.clip(photo, 0, 255).astype(np.uint8), sky

    def _light(self, x: Float64Array, y: Float64Array) -> Float32Array:
        """Of slopes under a sun from the south west, and of the roughness of what grows there."""
        row, col = self._surface.geometry.cell_of(x, y)
        rows, cols = self._lit.shape
        return self._lit[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)]

    @cached_property
    def _lit(self) -> Float32Array:
        """Of each cell of the surface."""
        down, right = np.gradient(self._surface.elevation, self._surface.geometry.resolution)
        lit = np.clip(0.75 + 0.5 * (down - right) / np.sqrt(1 + down**2 + right**2), 0.35, 1.15)
        return np.asarray(lit, np.float32)
