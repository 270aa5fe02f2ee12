"""Compiled loop that merges the evidence of disjoint frames, cell by cell."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ltm_core.fuel.evidence_kernel import remember, slot_of


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _add_capped(sums: Any, more: Any) -> None:
    """To each number of a row, which ends at the largest there is."""
    ceiling = np.uint64(np.iinfo(np.uint32).max)
    for k in range(sums.size):
        sums[k] = np.uint32(min(np.uint64(sums[k]) + np.uint64(more[k]), ceiling))


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _least(one: Any, other: Any) -> Any:
    """The lesser of two, where 0 is none."""
    return other if one == 0 or 0 < other < one else one


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def merge_cells(
    shown: Any,
    best: Any,
    span: Any,
    epochs: Any,
    first: Any,
    last: Any,
    camera_hashes: Any,
    seen_by: Any,
    last_seen: Any,
    woody: Any,
    woody_epoch: Any,
    more_shown: Any,
    more_best: Any,
    more_span: Any,
    more_epochs: Any,
    more_first: Any,
    more_last: Any,
    more_camera_hashes: Any,
    more_seen_by: Any,
    more_last_seen: Any,
    more_woody: Any,
    more_woody_epoch: Any,
) -> None:
    """Into the state of a tile that of other frames: (tile, tile, *shape) each, see `evidence_state`."""
    for r in range(last_seen.shape[0]):
        for c in range(last_seen.shape[1]):
            last_seen[r, c] = max(last_seen[r, c], more_last_seen[r, c])
            for k in range(more_seen_by.shape[2]):
                if more_seen_by[r, c, k] != 0:
                    remember(seen_by[r, c], more_seen_by[r, c, k])
            for f in range(first.shape[2]):
                first[r, c, f] = _least(first[r, c, f], more_first[r, c, f])
                last[r, c, f] = max(last[r, c, f], more_last[r, c, f])
                for k in range(more_camera_hashes.shape[3]):
                    if more_camera_hashes[r, c, f, k] != 0:
                        remember(camera_hashes[r, c, f], more_camera_hashes[r, c, f, k])
            for v in range(epochs.shape[2]):
                for k in range(epochs.shape[3]):
                    epoch = more_epochs[r, c, v, k]
                    if epoch == 0:
                        break  # newest first: nothing follows
                    e = slot_of(epochs[r, c, v], epoch, shown[r, c, v], best[r, c, v], span[r, c, v])
                    if e < 0:
                        break  # the view has newer looks enough
                    _add_capped(shown[r, c, v, e], more_shown[r, c, v, k])
                    best[r, c, v, e] = max(best[r, c, v, e], more_best[r, c, v, k])
                    span[r, c, v, e, 0] = _least(span[r, c, v, e, 0], more_span[r, c, v, k, 0])
                    span[r, c, v, e, 1] = max(span[r, c, v, e, 1], more_span[r, c, v, k, 1])
                if more_woody_epoch[r, c, v] > woody_epoch[r, c, v]:
                    woody_epoch[r, c, v] = more_woody_epoch[r, c, v]
                    woody[r, c, v] = more_woody[r, c, v]
                elif more_woody_epoch[r, c, v] == woody_epoch[r, c, v]:
                    _add_capped(woody[r, c, v], more_woody[r, c, v])
