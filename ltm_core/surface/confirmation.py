"""Confirm the cells of a surface map on whose change independent views agree."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.surface.change import ChangeKind
from ltm_core.surface.confirmed_surface import ConfirmedSurface
from ltm_core.surface.surface_map import SurfaceMap


def confirmed_surface(surface: SurfaceMap) -> tuple[ConfirmedSurface, int]:
    """Return the changed cells, and the number of cells that independent views have judged.

    Where something was removed, of two surfaces the nearer is taken: what is left of it, or bare earth where less than
    half is left. Bare earth itself follows where the ground is lower.
    """
    geometry = surface.reference.geometry
    found: list[tuple[NDArray[Any], ...]] = []
    seen = 0
    top, left, height, width = surface.seen_window() or (0, 0, 0, 0)
    for row in range(top, top + height, _STRIP):
        layers = surface.layers((row, left, min(_STRIP, top + height - row), width))
        seen += int((layers.observed | (layers.change > 0)).sum())
        changed = (layers.change > 0) & np.isfinite(layers.height)
        rows, cols = np.nonzero(changed)
        kind, now, bare = layers.change[changed], layers.height[changed], layers.bare[changed]
        ground = np.where(kind == ChangeKind.LOWERED, now, np.float32(np.nan))
        gone = (kind == ChangeKind.REMOVED) & (now - bare < (layers.reference[changed] - bare) / 2)
        visible = np.where(kind == ChangeKind.LOWERED, now, np.where(gone, bare, np.fmax(now, bare)))
        found.append((rows + row, cols + left, visible, ground))
    if not found:
        nothing = np.empty(0, np.float32)
        return ConfirmedSurface(geometry, np.empty(0, np.int32), np.empty(0, np.int32), nothing, nothing), 0
    rows, cols, visible, ground = (np.concatenate(parts) for parts in zip(*found, strict=True))
    cells = rows.astype(np.int32), cols.astype(np.int32)
    return ConfirmedSurface(geometry, *cells, visible.astype(np.float32), ground.astype(np.float32)), seen


_STRIP = 256
"""Number of rows processed at a time; the layers of a whole site may exceed the memory."""
