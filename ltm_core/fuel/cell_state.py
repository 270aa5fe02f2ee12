"""Define the state that the fuel map keeps of each cell, and compute tree cover from it.

A pixel is counted in the cell where its ray meets the ground. It shows a plant where a crown stands before that ground,
so the share of pixels without trees and shrubs is the *gap fraction* P of the stand in that direction, and crowns hide
more ground the flatter the sight. For crowns that stand at random, ellipsoids of half the length b and the radius r,

    ln P = k ln(1 - cover),    k = sqrt(1 + (b / (r t))^2),    t = tangent of the angle between sight and ground

since a crown's shadow along the sight is k times that from above (Beer and Lambert's law for crowns in place of leaves:
Nilson 1999, Inversion of gap frequency data in forest stands, Agric. For. Meteorol. 98-99; Li and Strahler 1992,
IEEE Trans. Geosci. Remote Sens. 30(2)). Shrubs count with the trees: the networks here call close stands shrub."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.kernels import kernel
from ltm_core.base.types import Float64Array, Int64Array, UInt32Array
from ltm_core.fuel.life_form import FORMS, LifeForm, form_counts
from ltm_core.fuel.votes import CellVotes
from ltm_core.storage.tile_store_schema import Field

CROWN_ASPECT: Final = 2.5
"""Ratio b / r of crowns. This and the following constants were chosen on rendered sites (docs/maps.md)."""
_SURE: Final = 0.95
"""Share of pixels above which, or below 1 - it, only the network's errors are seen."""
_BLIND: Final = 0.5
"""Weight of a view that sees no gap, which may only mean that the line of sight is flat."""
_SIGMA: Final = 0.8
"""Standard deviation of ln(-ln(1 - cover)) from one view, and from a prior map."""
_ALIKE: Final = 0.4
"""Correlation of the errors of two views of a cell: the `network` correlation of its labels."""
_LEAST_PIXELS: Final = 10
_SCALE: Final = 255


def cover_fields(views: int) -> Mapping[str, Field]:
    """Return the fields of a cell's cover state: for each view the newest epoch with its frames, and their sums of
    shares of woody pixels and of cosines of incidence, both x 255. Integer sums do not depend on the order."""
    return {"woody": Field(np.uint32, (views, 3)), "woody_epoch": Field(np.uint16, (views,))}


@dataclass(frozen=True, eq=False)
class WoodyLooks:
    """Woody pixels of a frame by cell: `rows`, `cols` (N,); `sums`: (N, 3) 1, share of woody pixels, cosine of
    incidence. `bearing`: (N,) radians."""

    rows: Int64Array
    cols: Int64Array
    sums: UInt32Array
    bearing: Float64Array


def woody_looks(votes: CellVotes, forms: Int64Array) -> WoodyLooks | None:
    """Return the observations of cells that a frame sees with at least ten pixels and locates to within a cell; None
    without visibility. `forms`: (K,) index of each label's life form, -1 for none."""
    seen = votes.visibility
    if seen is None:
        return None
    counts = form_counts(votes.counts, forms)
    pixels = counts @ np.ones(FORMS)
    placed = np.maximum(seen.sigma_along, seen.sigma_across) <= votes.geometry.resolution
    good = (pixels >= _LEAST_PIXELS) & placed & (seen.cos_incidence > 0)
    woody = (counts[good, LifeForm.SHRUB - 1] + counts[good, LifeForm.TREE - 1]) / pixels[good]
    parts = np.ones(len(woody)), _SCALE * woody, _SCALE * seen.cos_incidence[good].astype(np.float64)
    sums = np.rint(np.stack(parts, axis=-1)).astype(np.uint32)
    rows, cols = votes.rows[good].astype(np.int64), votes.cols[good].astype(np.int64)
    return WoodyLooks(rows, cols, sums, seen.bearing[good].astype(np.float64))


def add_looks(state: Mapping[str, NDArray[Any]], looks: WoodyLooks, views: Int64Array, second: int, epoch: int) -> None:
    """Add them to the state (H, W, ...) of a grid, where the cell has not burned since and the view (N,) has no newer
    epoch. Frames may come in any order."""
    _add(
        *(looks.rows, looks.cols, views, looks.sums, second, epoch),
        *(state[name] for name in ("burned_at", "woody_epoch", "woody")),
    )


@kernel()
def _add(
    rows: Any, cols: Any, views: Any, sums: Any, second: int, epoch: int, burned_at: Any, epochs: Any, woody: Any
) -> None:
    ceiling = np.uint64(np.iinfo(np.uint32).max)
    for i in range(rows.size):
        r, c, v = rows[i], cols[i], views[i]
        if burned_at[r, c] > second or epochs[r, c, v] > epoch:
            continue
        if epochs[r, c, v] != epoch:
            epochs[r, c, v] = epoch
            woody[r, c, v] = 0
        for k in range(sums.shape[1]):
            # At the largest number, which does not depend on the order of the frames: of one view, 17 million in
            # ten days.
            woody[r, c, v, k] = min(np.uint64(woody[r, c, v, k]) + np.uint64(sums[i, k]), ceiling)


def label_cover(woody: UInt32Array, before: Float64Array) -> Float64Array:
    """Return cover (...), %, from the sums (..., V, 3) of views and from an earlier map `before` (...), %; NaN where
    either is missing. Computed on ln(-ln(1 - cover)), in which k is a shift."""
    frames = woody[..., 0].astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        share, cosine = woody[..., 1] / (_SCALE * frames), woody[..., 2] / (_SCALE * frames)
    # Cosine of incidence: the sine of the angle between sight and ground.
    sine = np.clip(cosine, 0.02, 0.999)
    shadow_squared = 1 + CROWN_ASPECT**2 * (1 - sine**2) / sine**2
    each = _log_density(share) - 0.5 * np.log(shadow_squared)
    weight = np.where(frames > 0, np.where(share > _SURE, _BLIND, 1.0), 0.0)
    whole = weight.sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (weight * np.nan_to_num(each)).sum(axis=-1) / whole
        # The mean of n views whose errors are partly alike; of less than one view, all the less.
        variance = _SIGMA**2 * np.where(whole < 1, 1 / whole, _ALIKE + (1 - _ALIKE) / whole)
        trust = 1 / variance, 1 / _SIGMA**2
        found = (trust[0] * mean + trust[1] * _log_density(before / 100)) / sum(trust)
    known = (whole > 0) & np.isfinite(before)
    return np.where(known, 100 * (1 - np.exp(-np.exp(found))), np.nan)


def _log_density(share: Float64Array) -> Float64Array:
    """ln(-ln(1 - share)): of crowns that stand at random, the logarithm of their area by that of the ground."""
    return np.asarray(np.log(-np.log(1 - np.clip(share, 1 - _SURE, _SURE))))


CAMERAS_KEPT: Final = 8
"""Maximum number of cameras that a cell records; of more, those with the smallest name hashes are kept."""
VIEWS: Final = 6
"""Number of directions from which a cell is seen. Frames from one direction are one view, whichever cameras took them:
they see the same side of the same plants, and the network makes the same errors."""
EPOCHS: Final = 2
"""Number of most recent epochs kept for each view; newer observations of a view replace older ones."""
EPOCH_S: Final = 10 * 86400
"""Length of an epoch in seconds, long enough for several weather situations."""
UNIT: Final = 256
"""Resolution of evidence: it is kept as integer multiples of 1 / UNIT, so that sums do not depend on the order."""
TILE: Final = 32
"""Number of cells per side of the state's tiles."""
EVIDENCE_VERSION: Final = 3

EVIDENCE_FIELDS: Final[Mapping[str, Field]] = {
    "shown": Field(np.uint32, (VIEWS, EPOCHS, FORMS)),  # sum of what the frames say for each form
    "best": Field(np.uint16, (VIEWS, EPOCHS)),  # the most that a frame says
    "span": Field(np.uint32, (VIEWS, EPOCHS, 2)),  # seconds of the earliest and the latest frame; 0 none
    "epochs": Field(np.uint16, (VIEWS, EPOCHS)),  # their numbers from 1970 on, newest first; 0 none
    "first": Field(np.uint32, (FORMS,)),  # second of the earliest frame that shows the form; 0 none
    "last": Field(np.uint32, (FORMS,)),  # of the latest
    "camera_hashes": Field(np.uint32, (FORMS, 2)),  # hashes of two cameras that show the form; 0 none
    "seen_by": Field(np.uint32, (CAMERAS_KEPT,)),  # hashes of cameras that see the cell, rising; 0 none
    "last_seen": Field(np.uint32),  # second of the latest frame
    "burned_at": Field(np.uint32),  # second of the latest burn added to the map; 0 none
    **cover_fields(VIEWS),  # shares of woody pixels by view, of its newest epoch
}
"""State of a cell. Seconds count from 1970; a tile is an array of each field, (tile, tile, *shape)."""
ACCUMULATED: Final = tuple(name for name in EVIDENCE_FIELDS if name not in cover_fields(VIEWS))
"""Fields that `evidence_kernel.accumulate` updates, in its order."""
