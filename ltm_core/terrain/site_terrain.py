"""A site's surface map and how measured frames come into it, the same for the node `terrain` and for an archive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ltm_core.camera import Camera
from ltm_core.errors import ConfigError
from ltm_core.fuel.site_label_errors import site_label_errors
from ltm_core.pose import Pose
from ltm_core.raster.tile_store import StoreSchema, TileStore
from ltm_core.resources import config_path
from ltm_core.site import Site
from ltm_core.terrain.observation import DepthFrame
from ltm_core.terrain.reference_surface import Reference
from ltm_core.terrain.surface_map import Added, SurfaceMap
from ltm_core.terrain.tile_pool import schema_of
from ltm_core.types import Float32Array, Float64Array, UInt8Array
from ltm_core.vision.labels import LabelSet

STORE_FILE = "terrain.sqlite"
STABLE_CLASSES = ("grass", "bare", "built")
"""Whose surface stays where it is: what a frame is registered on."""
UNCOMMITTED = 500
"""Frames that wait to be stored at most."""


class SiteTerrain:
    """The surface map `map` of a site with a section `terrain`, in the `store` that `open_store` gives for its schema.

    Raises ConfigError for a site without that section, and as `Site.open_dem` and `SurfaceMap` do.
    """

    def __init__(self, site: Site, open_store: Callable[[StoreSchema], TileStore]) -> None:
        if site.terrain is None:
            raise ConfigError(
                f"site {site.name}: has no section `terrain`; add one (`terrain: {{}}` takes the defaults)"
            )
        labels = LabelSet.load(config_path(site.labels))
        self._stable = np.zeros(256, np.bool_)
        self._stable[[labels.id_of(name) for name in STABLE_CLASSES]] = True
        bare = site.open_dem()
        surface = site.open_surface(bare) if site.surface is not None else None
        reference = Reference.of(bare, surface, site.terrain.resolution)
        del bare, surface
        self.store = open_store(schema_of(site.in_crs(reference.geometry)))
        self.map = SurfaceMap(
            reference,
            site.terrain,
            tuple(site.cameras),
            self.store,
            site.curvature,
            site.refraction,
            site_label_errors(site).open_odds(),
            site.assumed_pose_error,
        )

    def add(
        self,
        depth: Float32Array,
        sigma: Float32Array,
        camera: Camera,
        pose: Pose,
        stamp_ns: int,
        source: str,
        covariance: Float64Array | None,
        labels: UInt8Array | None,
    ) -> Added:
        """Take in what was measured in a photo of `camera`; arguments as of `DepthFrame.of_photo`. Raises LtmError as
        it and `SurfaceMap.add` do."""
        frame = DepthFrame.of_photo(depth, sigma, camera, pose, stamp_ns, source, covariance, labels)
        if frame.labels is not None:
            frame = replace(frame, stable=self._stable[frame.labels])
        return self.map.add(frame)
