from __future__ import annotations

import numpy as np
import pytest
from scenes.any_votes import GRID, LABELS

from ltm_core.base.types import Float64Array, UInt32Array
from ltm_core.fuel.cell_state import CROWN_ASPECT, EPOCH_S, VIEWS, label_cover
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.votes import CellVisibility, CellVotes

BEGIN = 1_700_000_000
NOTHING = np.full(GRID.shape, 50.0)


def look(woody: int, of: int, cosine: float = 0.4, second: int = BEGIN, bearing: float = 0.1) -> CellVotes:
    """Of cell (1, 2): so many of its pixels show shrubs and trees, half each, the others grass."""
    counts = np.zeros((1, len(LABELS)), np.uint32)
    names = LABELS.names
    counts[0, names.index("tree")], counts[0, names.index("shrub")] = woody - woody // 2, woody // 2
    counts[0, names.index("grass")] = of - woody
    columns = (np.array([v], np.float32) for v in (cosine, 2.0, 1.0, 1.0, bearing))
    cell = np.array([1], np.int32), np.array([2], np.int32)
    seen = CellVisibility(*columns)
    return CellVotes(GRID, *cell, counts, np.zeros(1, np.float32), second * 10**9, "north", None, seen)


def evidence(*looks: CellVotes) -> EvidenceMap:
    found = EvidenceMap(GRID, None, LABELS)
    for one in looks:
        found.add(one)
    return found


def sums(shares: list[float], cosines: list[float], frames: int = 40) -> UInt32Array:
    """(1, V, 3) of as many views."""
    state = np.zeros((1, VIEWS, 3), np.uint32)
    for view, (share, cosine) in enumerate(zip(shares, cosines, strict=True)):
        state[0, view] = frames, round(255 * frames * share), round(255 * frames * cosine)
    return state


def woody_share(cover: float, cosine: float) -> float:
    """What crowns of the model's form, at random, show of themselves at an angle."""
    tangent = cosine / np.sqrt(1 - cosine**2)
    return float(1 - (1 - cover) ** np.sqrt(1 + (CROWN_ASPECT / tangent) ** 2))


@pytest.mark.parametrize("cosine", [0.2, 0.5, 0.95])
def test_the_flatter_the_sight_the_more_pixels_show_crowns_of_the_same_stand(cosine: float) -> None:
    """What is known before agrees, so that the result is the stand's cover whatever weighs how much."""
    cover = label_cover(sums([woody_share(0.2, cosine)], [cosine]), np.array([20.0]))
    assert cover[0] == pytest.approx(20.0, abs=0.6)


def test_labels_and_what_is_known_before_meet_by_their_errors() -> None:
    before = np.array([80.0])
    one, several = (
        label_cover(sums([woody_share(0.2, c) for c in angles], angles), before) for angles in ([0.5], [0.5, 0.4, 0.3])
    )
    assert 20 < several[0] < one[0] < 80


def test_nothing_is_said_of_cells_that_nobody_saw_or_that_had_no_trees() -> None:
    for state, before in ((np.zeros((1, VIEWS, 3), np.uint32), 50.0), (sums([0.5], [0.5]), np.nan)):
        assert np.isnan(label_cover(state, np.array([before]))).all()


def seen_cover(of: EvidenceMap) -> Float64Array:
    return of.label_cover(NOTHING)


def test_a_map_gathers_shares_of_the_newest_epoch_in_any_order() -> None:
    old, new, again = (
        look(90, 100),
        look(20, 100, second=BEGIN + 2 * EPOCH_S),
        look(40, 100, second=BEGIN + 2 * EPOCH_S),
    )
    found = [evidence(*order) for order in ((old, new, again), (again, old, new), (new, again, old))]
    states = [one.tile_state((0, 0)) for one in found]
    for state in states:
        assert state["woody"][1, 2, 0].tolist() == [2, 51 + 102, 204]
        np.testing.assert_array_equal(state["woody_epoch"], states[0]["woody_epoch"])
    cover = seen_cover(found[0])
    assert np.argwhere(np.isfinite(cover)).tolist() == [[1, 2]]
    assert cover[1, 2] < seen_cover(evidence(old))[1, 2]


def test_what_was_seen_before_a_burn_is_void() -> None:
    burned = evidence(look(20, 100))
    burned.burn(np.ones(GRID.shape, np.bool_), (BEGIN + 60) * 10**9)
    burned.add(look(20, 100, second=BEGIN + 30))
    assert np.isnan(seen_cover(burned)).all()
    burned.add(look(20, 100, second=BEGIN + 90))
    assert np.isfinite(seen_cover(burned)[1, 2])
