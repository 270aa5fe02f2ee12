import numpy as np
from scenes.evidence_scene import ASSUMED, HOUR, LABELS, NOW, visibility, votes

from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.evidence_kernel import pooled
from ltm_core.fuel.label_errors import FLOOR, LabelCorrelation, LabelErrors
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.prior import FuelPrior
from ltm_core.fuel.rules import FusionRules, supported_changes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.vision.labels import Label

SHRUB = 145
RULES = FusionRules()


def reported(odds: np.ndarray, company: np.ndarray | None = None) -> np.ndarray:
    """Of cells that look like trees where their log odds are above 0."""
    wanted = np.where(odds > 0, np.uint8(LifeForm.TREE), np.uint8(0))
    return supported_changes(wanted, odds, company, RULES, wanted)


def test_a_region_that_no_cell_is_sure_of_is_not_reported() -> None:
    """What a view mislabels again and again lies in such regions: large, and none of it sure."""
    odds = np.zeros((20, 20))
    odds[5:11, 5:11] = np.log(RULES.sure_odds) - 0.1
    assert not reported(odds).any()
    odds[7:9, 7:9] = RULES.support / 4 + 0.05
    assert np.array_equal(reported(odds), odds > 0)


def test_a_sure_region_supports_cells_so_far_and_not_farther() -> None:
    odds = np.zeros((7, 40))
    odds[2:5, 2:36] = 1.0
    odds[2:5, 2:5] = RULES.support / 3 + 0.01
    ends = np.flatnonzero(reported(odds)[3])
    assert (ends.min(), ends.max()) == (2, 4 + RULES.support_cells)  # cells that only lean do not carry it on


def test_what_the_terrain_has_changed_supports_what_cameras_see_beside_it() -> None:
    odds, company = np.zeros((12, 12)), np.zeros((12, 12), np.uint8)
    odds[4, 4:8] = 1.0
    company[5, 4:7] = LifeForm.TREE
    assert not reported(odds).any()
    assert reported(odds, company=company)[4, 4:8].all()
    company[5, 4:7] = LifeForm.GRASS
    assert not reported(odds, company=company).any()


def test_cells_that_look_changed_alone_are_not_reported() -> None:
    odds = np.zeros((20, 20))
    odds[4:9, 4:9] = RULES.support / 4
    odds[12, 4], odds[6, 12:14], odds[11, 10:13] = 2.0, 2.0, 2.0
    alone = odds == 2.0
    alone[11, 11] = False  # with one at each side
    assert np.array_equal(reported(odds), (odds > 0) & ~alone)


def test_holes_and_notches_that_lean_to_a_change_are_reported_with_it() -> None:
    wanted, odds = np.zeros((14, 17), np.uint8), np.zeros((14, 17))
    wanted[3:10, 4:13], odds[3:10, 4:13] = LifeForm.TREE, 4.0
    hole, notch = [(5, 6), (5, 7), (7, 10)], [(3, 7), (3, 8), (4, 7), (4, 8)]
    for cell in hole + notch:
        wanted[cell], odds[cell] = 0, 0.1
    leaning = np.full(wanted.shape, LifeForm.TREE, np.uint8)  # beyond the edges, too
    leaning[7, 10] = leaning[2] = LifeForm.GRASS
    filled = supported_changes(wanted, odds, None, RULES, leaning)
    expected = wanted > 0
    expected[5, 6:8] = expected[3:5, 7:9] = True
    np.testing.assert_array_equal(filled, expected)


WIDE = GridGeometry(15.0, 315.0, 30.0, 12, 12)
PATCH = [(row, col) for row in range(4, 8) for col in range(4, 8)]


def patch_of(*frames: tuple[float, float], shown: list[int], errors: LabelErrors) -> np.ndarray:
    """(4, 4) whether the map has changed a patch that frames, each of a bearing and an hour, see."""
    grid_map = EvidenceMap(WIDE, FuelPrior(np.full(WIDE.shape, SHRUB, np.int16), WIDE), LABELS, FusionRules(), errors)
    for bearing, hour in frames:
        seen = visibility(len(PATCH), bearing=bearing)
        grid_map.add(
            votes(shown, NOW + hour * HOUR, f"to {bearing}", cells=PATCH, visibility=seen, grid=WIDE)  # type: ignore[arg-type]
        )
    whole = grid_map.layers()
    for row, col in np.ndindex(6, 6):
        part = grid_map.layers((2 * row, 2 * col, 2, 2))
        np.testing.assert_array_equal(part.code, whole.code[2 * row : 2 * row + 2, 2 * col : 2 * col + 2])
    return np.asarray(whole.changed[4:8, 4:8])


def test_another_side_of_a_stand_supports_a_change_that_more_looks_of_one_do_not() -> None:
    """Errors of a view repeat, those of two sides mostly do not: what they say multiplies."""
    shown = [0] * len(LABELS)
    shown[Label.TREE], shown[Label.SHRUB] = 33, 7
    systematic = LabelErrors(ASSUMED.shares, LabelCorrelation(cell=1.0, stand=1.0, view=1.0, network=0.1))
    again = patch_of(*((0.0, 2.0 * k) for k in range(6)), shown=shown, errors=systematic)
    both = patch_of((0.0, 0.0), (2.5, 2.0), (-2.5, 4.0), shown=shown, errors=systematic)
    assert not again.any()
    assert both.all()


def joint_odds(*views: tuple[int, int]) -> float:
    """Log odds of the first form over the second by views that show both so much, which are alike by 0.4."""
    shown, best, span = (
        np.zeros((1, 6, 2, 7), np.uint32),
        np.zeros((1, 6, 2), np.uint16),
        np.ones((1, 6, 2, 2), np.uint32),
    )
    for view, shares in enumerate(views):
        shown[0, view, 0, :2], best[0, view, 0] = shares, sum(shares)
    _, told = pooled(shown, best, span, 1.0, np.full(7, 1e9), 3600.0, 0.9, 0.4, 2560.0, FLOOR)
    return float(told[0, 0] - told[0, 1])


def test_a_view_that_tells_little_takes_nothing_from_another() -> None:
    clear = joint_odds((2304, 256))
    np.testing.assert_allclose(clear, np.log(9), rtol=0.05)  # no form is taken to have less than FLOOR
    np.testing.assert_allclose(joint_odds((2304, 256), (1280, 1280)), clear, rtol=1e-9)
    np.testing.assert_allclose(joint_odds((2304, 256), (2304, 256)), 2 * clear / 1.4, rtol=1e-9)
