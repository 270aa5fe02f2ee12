"""Merge the evidence of disjoint sets of frames into one map, with the bits of a map that has counted all of them.

Merging is commutative and associative. A frame that two parts hold is rejected: it would count twice. Of each field of
a cell's state (`evidence.EVIDENCE_FIELDS`):

| field | of two |
|---|---|
| `epochs` | the newest of the union, as many as are kept, newest first |
| `shown` | of each epoch that stays the sum, which ends at the largest number there is |
| `best`, `last`, `last_seen`, second of `span` | the largest |
| `first`, first of `span` | the least that is not 0 |
| `camera_hashes`, `seen_by` | the least of the union, as many as are kept, rising |
| `woody`, `woody_epoch` | of each view the newest epoch, and the sum of what is of it, at most the largest number |
| `burned_at` | must be the same: a burn is added to every part before its frames are counted |

Days of frames do not need the burns of other days: a burn voids earlier evidence, so the days before it are merged, the
burn is added to the map (`EvidenceMap.burn`), and then to parts whose frames all come after it (`after`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from ltm_core.base.errors import ArchiveError
from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Int64Array
from ltm_core.fuel.cell_state import EVIDENCE_FIELDS
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.evidence_kernel import remember, slot_of
from ltm_core.storage.tile_store_schema import Key, Tile


@helper()
def _add_capped(sums: Any, more: Any) -> None:
    """Add to each number of a row, clipped at the largest value."""
    ceiling = np.uint64(np.iinfo(np.uint32).max)
    for k in range(sums.size):
        sums[k] = np.uint32(min(np.uint64(sums[k]) + np.uint64(more[k]), ceiling))


@helper()
def _least(one: Any, other: Any) -> Any:
    """Return the lesser of two, where 0 is none."""
    return other if one == 0 or 0 < other < one else one


@kernel()
def merge_cells(mine: Any, other: Any) -> None:
    """Merge the state of other frames into a tile: the arrays `_MERGED`, (tile, tile, *shape), of each."""
    shown, best, span, epochs, first, last, camera_hashes, seen_by, last_seen, woody, woody_epoch = mine
    more_shown, more_best, more_span, more_epochs, more_first, more_last = other[:6]
    more_camera_hashes, more_seen_by, more_last_seen, more_woody, more_woody_epoch = other[6:]
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


_MERGED: Final = tuple(name for name in EVIDENCE_FIELDS if name != "burned_at")
"""Merged fields, in the order of the kernel."""


@dataclass(frozen=True, eq=False)
class PartialEvidence:
    """Evidence of some frames: `stamps` counted, by camera, increasing, and the tiles that they touch."""

    stamps: Mapping[str, Int64Array] = field(default_factory=dict)
    tiles: Mapping[Key, Tile] = field(default_factory=dict)

    def merged(self, other: PartialEvidence) -> PartialEvidence:
        """Return the merged evidence. Raises ArchiveError if both contain a frame, or have different burns."""
        return merged_parts([self, other])

    def after(self, evidence: EvidenceMap) -> PartialEvidence:
        """Return a copy with the burns of the map, all of which must be earlier than its frames, or were added before
        them."""
        told = {key: evidence.tile_state(key)["burned_at"] for key in self.tiles}
        return PartialEvidence(
            self.stamps,
            {k: {**tile, "burned_at": np.maximum(tile["burned_at"], told[k])} for k, tile in self.tiles.items()},
        )

    def merge_into(self, evidence: EvidenceMap) -> None:
        """Merge into a map, which must contain other frames. Raises ArchiveError if their burns differ."""
        for key, tile in self.tiles.items():
            state = evidence.tile_state(key)
            _merge_into_tile(state, tile)
            evidence.load_tile(key, state)


def merged_parts(parts: Iterable[PartialEvidence]) -> PartialEvidence:
    """Return all parts merged; the parts do not change.

    Raises ArchiveError where two hold a frame, or know of different burns."""
    stamps, tiles, own = dict[str, list[Int64Array]](), dict[Key, Tile](), set[Key]()
    for part in parts:
        for camera, theirs in part.stamps.items():
            stamps.setdefault(camera, []).append(theirs)
        for key, tile in part.tiles.items():
            if key not in tiles:
                tiles[key] = tile
                continue
            if key not in own:  # still the first part's
                tiles[key] = {name: array.copy() for name, array in tiles[key].items()}
                own.add(key)
            _merge_into_tile(tiles[key], tile)
    return PartialEvidence(
        {camera: _distinct(camera, of) for camera, of in stamps.items()}, dict(sorted(tiles.items()))
    )


def _merge_into_tile(tile: Tile, other: Tile) -> None:
    if not np.array_equal(tile["burned_at"], other["burned_at"]):
        raise ArchiveError("parts with different burns cannot be merged: add all burns to every part before its frames")
    merge_cells(tuple(tile[name] for name in _MERGED), tuple(other[name] for name in _MERGED))


def _distinct(camera: str, parts: list[Int64Array]) -> Int64Array:
    """Return all stamps of a camera, rising. Raises ArchiveError where two parts hold one."""
    found, counts = np.unique(np.concatenate(parts), return_counts=True)
    twice = found[counts > 1]
    if len(twice):
        raise ArchiveError(
            f"{len(twice)} frames of {camera}, the first of stamp {twice[0]} ns, are in two parts and would "
            "count twice; merge each result once"
        )
    return found
