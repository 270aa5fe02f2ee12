"""What pictures of a site's cameras are compared with, when their poses are sought."""

from __future__ import annotations

from ltm_core.pose_estimation.crest_cover import CANOPY_SURFACE
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig, SkylineConfig
from ltm_core.pose_estimation.pose_from_picture import Terrain
from ltm_core.site import Site


def site_terrain(site: Site) -> tuple[Terrain, PicturePoseConfig]:
    """The site's ground, with the tops of trees where it has a surface raster, and the constants that fit it.

    Raises DemError as `Site.open_dem`.
    """
    bare = site.open_dem()
    ground = site.open_surface(bare)
    config = PicturePoseConfig()
    if ground is not bare:
        config = PicturePoseConfig(skyline=SkylineConfig(cover=CANOPY_SURFACE))
    return Terrain(ground, site.bend, site.possible_ground), config
