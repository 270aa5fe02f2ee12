"""The living terrain: what fused depth says of the surface, and where views agree that it has changed.

`observation` turns a depth image into observations of cells, `cell_kernel` keeps a robust recursive estimate of each,
`change` decides by consensus, `surface_map` holds it together.
"""

from ltm_core.terrain.observation import DepthFrame, LabelImage
from ltm_core.terrain.reference_surface import Reference
from ltm_core.terrain.surface_map import SurfaceMap

__all__ = ["DepthFrame", "LabelImage", "Reference", "SurfaceMap"]
