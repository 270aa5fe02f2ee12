"""Merges evidence that was counted apart: the map of all frames from the maps of some of them, to the last bit.

Partial evidence is what a set of frames says. Merging is the union of disjoint sets: it is commutative and associative,
nothing is its neutral element, and the result is that of one map which has counted all frames in any order. A frame
that two parts hold is refused: it would count twice. Of each field of a cell's state (`evidence.EVIDENCE_FIELDS`):

| field | of two |
|---|---|
| `epochs` | the newest of the union, as many as are kept, newest first |
| `shown` | of each epoch that stays the sum, which ends at the largest number there is |
| `best`, `last`, `last_seen`, second of `span` | the largest |
| `first`, first of `span` | the least that is not 0 |
| `camera_hashes`, `seen_by` | the least of the union, as many as are kept, rising |
| `woody`, `woody_epoch` | of each view the newest epoch, and the sum of what is of it, at most the largest number |
| `burned_at` | must be the same: a burn is told to every part before its frames are counted |

Days of frames need not be told of the burns of other days: a burn voids what came before it, so the days before it are
merged, the map is told (`EvidenceMap.burn`), and parts of frames that all come after it know of it then (`after`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.errors import ArchiveError
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.evidence_state import EPOCHS
from ltm_core.fuel.label_cover import capped
from ltm_core.raster.tile_store_schema import Key, Tile
from ltm_core.types import Int64Array

_NONE = np.uint64(2**32)
"""Sorts behind every hash of a camera."""


@dataclass(frozen=True, eq=False)
class PartialEvidence:
    """What some frames say: `stamps`, by camera, rising, of those counted, and the tiles that they touch."""

    stamps: Mapping[str, Int64Array] = field(default_factory=dict)
    tiles: Mapping[Key, Tile] = field(default_factory=dict)

    def merged(self, other: PartialEvidence) -> PartialEvidence:
        """Raises ArchiveError where both hold a frame, or know of different burns."""
        stamps = dict(self.stamps)
        for camera, theirs in other.stamps.items():
            ours = stamps.get(camera, np.zeros(0, np.int64))
            if len(twice := np.intersect1d(ours, theirs)):
                raise ArchiveError(
                    f"{len(twice)} frames of {camera}, the first of stamp {twice[0]} ns, are in both parts that are to "
                    "be merged and would count twice; merge each result once"
                )
            stamps[camera] = np.union1d(ours, theirs)
        tiles = dict(self.tiles)
        for key, tile in other.tiles.items():
            tiles[key] = merged_tile(tiles[key], tile) if key in tiles else tile
        return PartialEvidence(stamps, dict(sorted(tiles.items())))

    def after(self, evidence: EvidenceMap) -> PartialEvidence:
        """The same, knowing of the burns that the map knows of, all of which must have been before its frames, or told
        to it before them."""
        told = {key: evidence.tile_state(key)["burned_at"] for key in self.tiles}
        return PartialEvidence(
            self.stamps,
            {k: {**tile, "burned_at": np.maximum(tile["burned_at"], told[k])} for k, tile in self.tiles.items()},
        )

    def merge_into(self, evidence: EvidenceMap) -> None:
        """Into what a map holds, which must be of other frames. Raises ArchiveError where they know of other burns."""
        for key, tile in self.tiles.items():
            evidence.load_tile(key, merged_tile(evidence.tile_state(key), tile))


def merged_tile(one: Tile, other: Tile) -> Tile:
    """The state of a tile from two of disjoint frames; neither is changed. Raises ArchiveError for different burns."""
    if not np.array_equal(one["burned_at"], other["burned_at"]):
        raise ArchiveError(
            "evidence that knows of different burns cannot be merged: tell all burns to every part before its frames"
        )
    return _merged_epochs(one, other) | {
        "first": _least(one["first"], other["first"]),
        "last": np.maximum(one["last"], other["last"]),
        "camera_hashes": _least_distinct(one["camera_hashes"], other["camera_hashes"]),
        "seen_by": _least_distinct(one["seen_by"], other["seen_by"]),
        "last_seen": np.maximum(one["last_seen"], other["last_seen"]),
        "burned_at": one["burned_at"].copy(),
        **_merged_cover(one, other),
    }


def _merged_cover(one: Tile, other: Tile) -> Tile:
    newest = np.maximum(one["woody_epoch"], other["woody_epoch"])
    parts = [np.where((t["woody_epoch"] == newest)[..., None], t["woody"], 0).astype(np.uint64) for t in (one, other)]
    return {"woody": capped(parts[0] + parts[1]), "woody_epoch": newest}


def _merged_epochs(one: Tile, other: Tile) -> Tile:
    """`epochs`, `shown`, `best` and `span` of the newest epochs; their axis is the fourth in each."""
    both = {name: np.concatenate([one[name], other[name]], axis=3) for name in ("epochs", "shown", "best", "span")}
    left = both["epochs"].copy()
    newest = []
    for _ in range(EPOCHS):
        newest.append(left.max(axis=3))
        left[left == newest[-1][..., None]] = 0
    merged: dict[str, list[NDArray[Any]]] = {"epochs": newest, "shown": [], "best": [], "span": []}
    for epoch in newest:
        member = (both["epochs"] == epoch[..., None]) & (epoch[..., None] > 0)
        shown = np.where(member[..., None], both["shown"], 0).sum(axis=3, dtype=np.uint64)
        merged["shown"].append(np.minimum(shown, np.iinfo(np.uint32).max).astype(np.uint32))
        merged["best"].append(np.where(member, both["best"], 0).max(axis=3))
        spans = np.where(member[..., None], both["span"], 0)
        begins = reduce(_least, np.moveaxis(spans[..., 0], 3, 0))
        merged["span"].append(np.stack([begins, spans[..., 1].max(axis=3)], axis=-1))
    return {name: np.stack(parts, axis=3) for name, parts in merged.items()}


def _least(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """The lesser of two, where 0 is none."""
    return np.where((one == 0) | ((other > 0) & (other < one)), other, one)


def _least_distinct(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """(..., n): the n least of the union of two such rows, rising, 0 where there are no more."""
    both = np.concatenate([one, other], axis=-1).astype(np.uint64)
    both[both == 0] = _NONE
    both.sort(axis=-1)
    both[..., 1:][both[..., 1:] == both[..., :-1]] = _NONE
    both.sort(axis=-1)
    both[both == _NONE] = 0
    return both[..., : one.shape[-1]].astype(one.dtype)
