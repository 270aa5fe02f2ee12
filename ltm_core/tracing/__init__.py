"""Algorithm 1 of the paper, made exact and fast: the point of the terrain that each pixel sees.

`TerrainTracer` is the tracer; `baselines.march` keeps the paper's own fixed-step march as a baseline;
`baselines.reference` is a slow, independent float64 tracer that tests hold the fast one against.
"""

from ltm_core.range_image import RangeImage
from ltm_core.tracing.tracer import TerrainTracer

__all__ = ["RangeImage", "TerrainTracer"]
