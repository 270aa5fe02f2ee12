"""Terrain tracing, fuel votes and all other algorithms of LTM, on NumPy arrays; knows no ROS."""

from pathlib import Path

from ltm_core.numba_cache import use_own_cache

use_own_cache(Path(__file__).parent)
