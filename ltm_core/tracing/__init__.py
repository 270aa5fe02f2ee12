"""Algorithm 1 of the paper, exact and fast: the point of the terrain that each pixel sees.

`TerrainTracer` is the tracer; `ltm_lab.tracers` has the paper's own fixed-step march, and a slow, independent float64
tracer that tests hold the fast one against."""

from typing import TYPE_CHECKING

from ltm_core.geometry.range_image import RangeImage

if TYPE_CHECKING:
    from ltm_core.tracing.tracer import TerrainTracer

__all__ = ["RangeImage", "TerrainTracer"]


def __getattr__(name: str) -> object:
    """Import the tracer on first use: a site's configuration needs only `possible_ground`, and the tracer loads numba
    with all its kernels."""
    if name == "TerrainTracer":
        from ltm_core.tracing.tracer import TerrainTracer

        return TerrainTracer
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
