"""The algorithms of LTM on NumPy arrays: terrain tracing, depth fusion, fuel map, terrain update. Knows no ROS."""

from pathlib import Path

from ltm_core.base.numba_cache import use_own_cache

use_own_cache(Path(__file__).parent)
