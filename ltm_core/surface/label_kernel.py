"""Use each label of an image as evidence whether vegetation of the reference still stands; compiled."""

from __future__ import annotations

import numpy as np

from ltm_core.base.kernels import kernel
from ltm_core.base.types import Float32Array, RecordArray, UInt8Array
from ltm_core.surface.cell_layout import NO_LABEL, FrameSums, sum_of
from ltm_core.surface.observation_kernel import ObservationLimits, Pixels
from ltm_core.surface.reference_surface import ReferenceGrid, stood_at

_EDGE = 0.5
"""Share of the height of an object within which neighbouring pixels may see it differently."""


@kernel()
def add_labels(
    ground: ReferenceGrid,
    expected_pixels: RecordArray,
    ids: UInt8Array,
    cosines: Float32Array,
    gone: Float32Array,
    depth: Pixels,
    limits: ObservationLimits,
    sums: FrameSums,
) -> None:
    """Add the label evidence of labels (H, W) by cell, as far as `sums` has room.

    `expected_pixels`: the reference's view of these pixels; `cosines`: their depth / slant range. `gone`: (256,) log
    odds by label that what stood is gone. `depth`: the measurement in the same photo, at its own size. Labels at an
    edge do not count, because they may be of what is beside it.
    """
    rows, cols = ids.shape
    height, width = depth.depth.shape
    for v in range(rows):
        below = v * height // rows
        for u in range(cols):
            odds, pixel = gone[ids[v, u]], expected_pixels[v, u]
            if odds == 0.0 or pixel.place < 0 or not limits.min_range < pixel.expected < limits.max_range:
                continue
            stood = stood_at(ground, pixel.place)
            if not stood >= limits.stands or pixel.spread * pixel.incidence > _EDGE * stood:
                continue
            across = u * width // cols
            if depth.informs[below, across]:
                farthest = depth.depth[below, across] + limits.gate * depth.sigma[below, across]
                if farthest < pixel.nearest * cosines[v, u]:
                    continue
            number = sum_of(sums, pixel.place)
            if number < 0:
                continue
            one = sums.cells[number]
            one.stood = stood
            one.labelled += 1.0
            one.gone += max(odds, np.float32(0.0))
            one.stays += max(-odds, np.float32(0.0))
            one.labelled_pose += pixel.pose_variance
            if one.label == NO_LABEL:
                one.label = ids[v, u]
