import numpy as np
import pytest
from scenes.evidence_scene import ASSUMED

from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.prior import FuelPrior
from ltm_core.fuel.rules import FusionRules
from ltm_core.fuel.surface_change import SurfaceNews, form_after, news_of, record
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.layers import UNSEEN
from ltm_core.vision.labels import LabelSet

pytestmark = pytest.mark.kernel

LABELS = LabelSet.load()
FUEL = GridGeometry(-45.0, 1000.0, 30.0, 70, 40)
NOW = 1_700_000_000
SECOND = 10**9
NONE, REMOVED, GROWN, LOWERED = ChangeKind
UNKNOWN = float("nan")


@pytest.mark.parametrize(
    ("kind", "shift", "form", "shown", "after"),
    [
        (REMOVED, -12.0, LifeForm.TREE, 255, LifeForm.GRASS),
        (REMOVED, -12.0, LifeForm.TREE, LifeForm.BARE, LifeForm.BARE),
        (REMOVED, -12.0, LifeForm.TREE, LifeForm.TREE, LifeForm.GRASS),
        (REMOVED, UNKNOWN, LifeForm.TREE, LifeForm.SHRUB, LifeForm.SHRUB),
        (REMOVED, -2.0, LifeForm.SHRUB, 255, LifeForm.GRASS),
        (REMOVED, -2.0, LifeForm.SHRUB, LifeForm.SHRUB, LifeForm.GRASS),
        (REMOVED, -12.0, LifeForm.SHRUB, 255, None),
        (REMOVED, UNKNOWN, LifeForm.SHRUB, 255, None),
        (REMOVED, -12.0, LifeForm.GRASS, 255, None),
        (REMOVED, -12.0, LifeForm.BURNED, 255, None),
        (GROWN, 2.0, LifeForm.GRASS, 255, LifeForm.SHRUB),
        (GROWN, 7.0, LifeForm.GRASS, 255, LifeForm.TREE),
        (GROWN, 7.0, LifeForm.GRASS, LifeForm.GRASS, LifeForm.TREE),
        (GROWN, 7.0, LifeForm.GRASS, LifeForm.SHRUB, LifeForm.SHRUB),
        (GROWN, UNKNOWN, LifeForm.BARE, 255, LifeForm.SHRUB),
        (GROWN, 2.0, LifeForm.SHRUB, 255, None),
        (GROWN, 7.0, LifeForm.SHRUB, 255, LifeForm.TREE),
        (GROWN, 7.0, LifeForm.TREE, 255, None),
        (LOWERED, -3.0, LifeForm.TREE, LifeForm.TREE, LifeForm.BARE),
        (LOWERED, -3.0, LifeForm.WATER, 255, None),
    ],
)
def test_what_stands_there_after_a_change(
    kind: ChangeKind, shift: float, form: int, shown: int, after: int | None
) -> None:
    assert form_after(kind, shift, form, shown) == after


def window() -> tuple[np.ndarray, np.ndarray, GridGeometry]:
    """A part of a 5 m terrain whose rows and columns do not begin on fuel cells."""
    geometry = GridGeometry(0.0, 900.0, 5.0, 210, 130)
    return np.zeros(geometry.shape, np.uint8), np.full(geometry.shape, np.nan, np.float32), geometry


def fuel_part(geometry: GridGeometry, row: int, col: int) -> tuple[slice, slice]:
    """The window's cells whose centres lie in a fuel cell."""
    west, north = FUEL.x_min + col * 30.0, FUEL.y_max - row * 30.0
    top, left = round((geometry.y_max - north) / 5), round((west - geometry.x_min) / 5)
    return slice(top, top + 6), slice(left, left + 6)


def test_news_are_the_cells_whose_change_is_another() -> None:
    kinds, shift, geometry = window()
    part = fuel_part(geometry, 10, 20)
    kinds[part], shift[part] = REMOVED, -9.0
    other = fuel_part(geometry, 18, 33)
    kinds[other], kinds[other[0].start, :] = GROWN, NONE
    told = np.zeros(FUEL.shape, np.uint8)
    told[14, 14], told[15, 15], told[30, 66] = GROWN, GROWN, REMOVED  # two taken back, one nobody looks at
    kinds[fuel_part(geometry, 15, 15)] = UNSEEN
    news = news_of(kinds, shift, geometry, FUEL, told)
    found = list(zip(news.rows.tolist(), news.cols.tolist(), news.kind.tolist(), strict=True))
    assert found == [(10, 20, REMOVED), (14, 14, NONE), (18, 33, GROWN)]
    np.testing.assert_array_equal(news.shift, np.array([-9.0, np.nan, np.nan], np.float32))
    told[news.rows, news.cols] = news.kind
    assert len(news_of(kinds, shift, geometry, FUEL, told)) == 0, "the same again is no news"


def test_a_fuel_cell_takes_over_what_enough_of_its_seen_part_shows() -> None:
    grid, fine = GridGeometry(0.0, 60.0, 30.0, 3, 2), GridGeometry(0.0, 60.0, 1.0, 90, 60)
    kinds, shift = np.zeros(fine.shape, np.uint8), np.zeros(fine.shape, np.float32)
    kinds[0:30, 30:50], shift[0:30, 30:50] = REMOVED, -11.0  # two thirds of fuel cell (0, 1)
    kinds[30:35, 0:30], shift[30:35, 0:30] = GROWN, 5.0  # a sixth of (1, 0): too little
    kinds[40:60, 60:90], shift[40:60, 60:90] = LOWERED, -3.0
    kinds[30:60, 30:60] = UNSEEN
    kinds[30:32, 30:60], shift[30:32, 30:60] = GROWN, 5.0  # 7 % of (1, 1) was seen: too little
    news = news_of(kinds, shift, fine, grid, np.zeros(grid.shape, np.uint8))
    found = list(zip(*(a.tolist() for a in (news.rows, news.cols, news.kind, news.shift)), strict=True))
    assert found == [(0, 1, REMOVED, -11.0), (1, 2, LOWERED, -3.0)]


def map_of(codes: np.ndarray | None, **rules: float) -> EvidenceMap:
    return EvidenceMap(FUEL, None if codes is None else FuelPrior(codes, FUEL), LABELS, FusionRules(**rules), ASSUMED)


CELLS = np.array([2, 33]), np.array([5, 40])


def told(evidence: EvidenceMap, kind: int, shift: float) -> FuelLayers:
    news = SurfaceNews(*CELLS, np.full(2, kind, np.uint8), np.full(2, shift, np.float32))
    before = {key: evidence.tile_state(key) for key in ((0, 0), (1, 1))}, evidence.surface_changes.copy()
    what, tiles = record(evidence, news)
    assert list(tiles) == [(0, 0), (1, 1)]
    np.testing.assert_array_equal(evidence.surface_changes, before[1])
    for key, state in before[0].items():
        for name, array in state.items():
            np.testing.assert_array_equal(evidence.tile_state(key)[name], array, err_msg="the map itself stays")
    whole = evidence.surface_changes.copy()
    whole[CELLS] = what
    evidence.recall(whole)
    for key, tile in tiles.items():
        evidence.load_tile(key, tile)
    np.testing.assert_array_equal(evidence.change_kinds[CELLS], kind)
    return evidence.layers()


def frame(label: int, second: int, source: str) -> CellVotes:
    """A camera's votes for the two cells of the news, and one beside them."""
    rows, cols = np.array([2, 2, 33], np.int32), np.array([5, 6, 40], np.int32)
    counts = np.zeros((3, len(LABELS)), np.uint32)
    counts[:, label] = 400
    return CellVotes(FUEL, rows, cols, counts, np.zeros(3, np.float32), second * SECOND, source)


@pytest.mark.parametrize("rules", [{}, {"prior_evidence": 12.0, "frame_cap": 2.0}])
@pytest.mark.parametrize(
    ("prior", "kind", "shift", "code"),
    [
        (183, REMOVED, -12.0, 102),
        (145, REMOVED, -2.0, 102),
        (102, GROWN, 9.0, 183),
        (145, GROWN, 9.0, 165),
        (102, GROWN, 2.0, 145),
        (122, LOWERED, -4.0, 99),
        (122, GROWN, 1.8, 122),
        (20, GROWN, 9.0, 20),
        (256, GROWN, 9.0, 256),
    ],
)
def test_told_cells_change_and_no_others(
    prior: int, kind: int, shift: float, code: int, rules: dict[str, float]
) -> None:
    codes = np.full(FUEL.shape, prior, np.int16)
    codes[:, 50:] = -9999
    evidence = map_of(codes, **rules)
    changed = np.zeros(FUEL.shape, bool)
    changed[CELLS] = code != prior
    after = told(evidence, kind, shift)
    np.testing.assert_array_equal(after.changed, changed)
    np.testing.assert_array_equal(after.prior, codes)
    np.testing.assert_array_equal(after.code, np.where(changed, code, codes))
    part = evidence.layers((1, 4, 5, 6))
    np.testing.assert_array_equal(part.changed, changed[1:6, 4:10])
    np.testing.assert_array_equal(part.prior, codes[1:6, 4:10])
    back = told(evidence, NONE, UNKNOWN)
    np.testing.assert_array_equal(back.code, codes)
    assert not back.changed.any()


def test_what_cameras_saw_before_is_void_and_what_they_see_after_counts() -> None:
    evidence = map_of(np.full(FUEL.shape, 102, np.int16), support=0.0, block_cells=1)
    for day in range(6):
        for camera in ("north", "east", "south"):
            evidence.add(frame(LifeForm.TREE, NOW - 10**7 + day * 20 * 86400, camera))
    assert set(evidence.layers().life_form[[2, 2, 33], [5, 6, 40]].tolist()) == {LifeForm.TREE}
    felled = told(evidence, REMOVED, -15.0)
    assert felled.life_form[CELLS].tolist() == [LifeForm.GRASS] * 2
    assert not felled.changed[CELLS].any(), "the prior was grass: it is the prior's code again"
    assert (felled.evidence[CELLS] == 0).all()
    assert (felled.seen_by[CELLS] == 3).all()
    assert felled.life_form[2, 6] == LifeForm.TREE, "the neighbour stands"
    for day in range(1, 20):
        for camera in ("north", "east", "south"):
            evidence.add(frame(LifeForm.SHRUB, NOW + day * 20 * 86400, camera))
    assert evidence.layers().life_form[2, 5] == LifeForm.SHRUB
