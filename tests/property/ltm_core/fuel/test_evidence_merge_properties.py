"""Evidence counted apart and merged is, to the last bit, that of one map which has counted all of it."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes.any_votes import GRID, LABELS, frames
from scenes.examples import examples

from ltm_core.base.errors import ArchiveError
from ltm_core.fuel.cell_state import EVIDENCE_FIELDS
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.evidence_merge import PartialEvidence
from ltm_core.fuel.votes import CellVotes
from ltm_core.storage.tile_store_schema import Tile

pytestmark = pytest.mark.kernel


@st.composite
def distinct_frames(draw: st.DrawFn) -> list[CellVotes]:
    """Of many cameras, for cells remember but eight; each of a stamp of its own."""
    found = draw(st.lists(frames(), min_size=1, max_size=9))
    cameras = draw(st.lists(st.integers(0, 11), min_size=len(found), max_size=len(found)))
    return [
        replace(frame, source=f"camera_{camera}", stamp_ns=frame.stamp_ns + number)
        for number, (frame, camera) in enumerate(zip(found, cameras, strict=True))
    ]


def part(of: list[CellVotes], burned_at: int = 0) -> PartialEvidence:
    evidence = EvidenceMap(GRID, None, LABELS)
    if burned_at:
        evidence.burn(np.indices(GRID.shape).sum(axis=0) % 2 == 0, burned_at)
    stamps: dict[str, list[int]] = {}
    for frame in of:
        if evidence.add(frame) is not None:
            stamps.setdefault(frame.source, []).append(frame.stamp_ns)
    known = {camera: np.array(sorted(found), np.int64) for camera, found in stamps.items()}
    return PartialEvidence(known, {(0, 0): evidence.tile_state((0, 0))})


def assert_same(found: PartialEvidence, expected: PartialEvidence) -> None:
    assert found.tiles.keys() == expected.tiles.keys()
    for key, tile in expected.tiles.items():
        for name in EVIDENCE_FIELDS:
            np.testing.assert_array_equal(found.tiles[key][name], tile[name], err_msg=f"{key} {name}")
            assert found.tiles[key][name].dtype == tile[name].dtype
    assert {c: s.tolist() for c, s in found.stamps.items()} == {c: s.tolist() for c, s in expected.stamps.items()}


@examples(20, in_fuzz=80)
@given(distinct_frames(), st.data())
def test_any_tree_over_any_chunks_gives_the_map_of_all_frames(of: list[CellVotes], data: st.DataObject) -> None:
    """Which is that it is commutative and associative, and that nothing is lost or doubled on the way."""
    burned_at = data.draw(st.sampled_from([0, of[0].stamp_ns]))
    chunk_of = data.draw(st.lists(st.integers(0, 4), min_size=len(of), max_size=len(of)))
    parts = [part([f for f, c in zip(of, chunk_of, strict=True) if c == chunk], burned_at) for chunk in set(chunk_of)]
    while len(parts) > 1:
        one = parts.pop(data.draw(st.integers(0, len(parts) - 1)))
        other = parts.pop(data.draw(st.integers(0, len(parts) - 1)))
        parts.append(one.merged(other))
    assert_same(parts[0], part(of, burned_at))


@examples(12, in_fuzz=30)
@given(distinct_frames())
def test_nothing_is_the_neutral_element(of: list[CellVotes]) -> None:
    whole, empty = part(of), EvidenceMap(GRID, None, LABELS)
    whole.merge_into(empty)
    assert_same(PartialEvidence(whole.stamps, {(0, 0): empty.tile_state((0, 0))}), whole)
    assert_same(PartialEvidence().merged(whole), whole)
    assert_same(whole.merged(PartialEvidence()), whole)


@examples(12, in_fuzz=30)
@given(distinct_frames(), distinct_frames())
def test_what_two_parts_hold_is_refused_and_never_doubled(of: list[CellVotes], more: list[CellVotes]) -> None:
    whole, alike = part(of), {(frame.source, frame.stamp_ns) for frame in of}
    if not whole.stamps:
        return
    fresh = part([frame for frame in more if (frame.source, frame.stamp_ns) not in alike])
    with pytest.raises(ArchiveError, match="would count twice"):
        reduce(PartialEvidence.merged, [fresh, whole, part(of[:1]) if part(of[:1]).stamps else whole])


def merged_tile(one: Tile, other: Tile) -> Tile:
    first, second = (PartialEvidence({}, {(0, 0): tile}) for tile in (one, other))
    return dict(first.merged(second).tiles[0, 0])


def test_sums_end_at_the_largest_number() -> None:
    empty = EvidenceMap(GRID, None, LABELS).tile_state((0, 0))
    full = {name: array.copy() for name, array in empty.items()}
    full["shown"][1, 2, 3, 0, :] = 2**32 - 10
    full["epochs"][1, 2, 3, 0] = 7
    merged = merged_tile(full, full)
    assert merged["shown"][1, 2, 3, 0].tolist() == [2**32 - 1] * full["shown"].shape[-1]
    assert int((merged["shown"] > 0).sum()) == full["shown"].shape[-1]


def test_sums_of_woody_pixels_at_the_largest_number_do_not_hang_on_the_order() -> None:
    tiles = []
    for amount in (2**32 - 10, 6, 7):
        tile = {n: array.copy() for n, array in EvidenceMap(GRID, None, LABELS).tile_state((0, 0)).items()}
        tile["woody"][1, 2, 3], tile["woody_epoch"][1, 2, 3] = (5, amount, 9), 7
        tiles.append(tile)
    ways = [merged_tile(merged_tile(tiles[a], tiles[b]), tiles[c])["woody"] for a, b, c in permutations(range(3))]
    for way in ways:
        np.testing.assert_array_equal(way, ways[0])
    assert ways[0][1, 2, 3].tolist() == [15, 2**32 - 1, 27]


def test_parts_that_know_of_different_burns_are_refused() -> None:
    tile = EvidenceMap(GRID, None, LABELS).tile_state((0, 0))
    burned = {name: array.copy() for name, array in tile.items()}
    burned["burned_at"][1, 0] = 5
    with pytest.raises(ArchiveError, match="different burns"):
        merged_tile(tile, burned)
