from dataclasses import replace

import numpy as np
import pytest
from scenes.evidence_scene import (
    ASSUMED,
    CODES,
    GRID,
    HOUR,
    INDEPENDENT,
    LABELS,
    NOW,
    PRIOR,
    TRUSTED,
    YEAR,
    fuel_map,
    visibility,
    votes,
)

from ltm_core.base.errors import ImageError
from ltm_core.fuel.evidence import EPOCH_S, TILE, EvidenceMap
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.prior import FuelPrior
from ltm_core.fuel.rules import FRAME_CAP, FusionRules
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.vision.labels import Label, LabelSet

pytestmark = pytest.mark.kernel


def test_two_frames_an_hour_apart_change_a_life_form() -> None:
    layers = fuel_map(votes(Label.TREE), votes(Label.TREE, NOW + HOUR)).layers()
    np.testing.assert_array_equal(layers.code[0], [165, 165, 165])
    np.testing.assert_array_equal(layers.changed, [[True, True, False], [True, False, False]])
    assert (layers.code[1, 0], layers.life_form[1, 0]) == (165, LifeForm.TREE)  # 121 has shrubs too
    assert (layers.code[1, 1], layers.life_form[1, 1]) == (91, LifeForm.BUILT)  # masked: never changed
    assert layers.code[1, 2] == 183  # no prior there: what is seen
    assert layers.last_seen[0, 0] == (NOW + HOUR) * 10**9


@pytest.mark.parametrize("kept", [256, 20, 95])
def test_what_is_seen_never_changes_a_code_of_no_known_form(kept: int) -> None:
    """A prior's own marks that `unknown_codes: keep` lets pass, and an analyst's models."""
    codes = np.where(CODES == 145, np.int16(kept), CODES)
    assert (codes == kept).any()
    layers = fuel_map(votes(Label.TREE), votes(Label.TREE, NOW + HOUR), prior=FuelPrior(codes, GRID)).layers()
    assert (layers.code[codes == kept] == kept).all()
    assert not layers.changed[codes == kept].any()
    assert layers.changed.any()


def test_frames_less_than_an_hour_apart_do_not() -> None:
    burst = [votes(Label.TREE, NOW + k) for k in range(20)]
    layers = fuel_map(*burst).layers()
    np.testing.assert_array_equal(layers.code.ravel()[:5], CODES.ravel()[:5])
    # Twenty frames of twenty seconds are one look of a view.
    assert layers.evidence[0, 0] < 1.01 * FRAME_CAP
    assert layers.p_max[0, 0] > 0.9


def test_two_cameras_need_no_hour() -> None:
    layers = fuel_map(votes(Label.TREE), votes(Label.TREE, NOW + 1, "south")).layers()
    assert layers.changed[0, 0]
    np.testing.assert_array_equal(layers.seen_by, 2)


def test_grass_and_shrub_together() -> None:
    layers = fuel_map(votes(Label.GRASS), votes(Label.SHRUB, NOW + HOUR), prior=None).layers()
    np.testing.assert_array_equal(layers.code, 122)
    np.testing.assert_array_equal(fuel_map(votes(Label.GRASS), prior=None).layers().code, 102)


@pytest.mark.parametrize("label", [label for label in Label if label != Label.SKY])
def test_each_form_has_its_own_time_constant(label: Label) -> None:
    grid_map = fuel_map(votes(label), errors=LabelErrors(np.eye(7), INDEPENDENT))
    years = getattr(FusionRules().decay_years, LifeForm(label).name.lower())
    now = grid_map.layers().evidence
    later = grid_map.layers(at_ns=int((NOW + years * YEAR) * 10**9)).evidence
    np.testing.assert_allclose(later / now, np.exp(-1), rtol=0.02)


def test_burned_labels_live_for_a_time() -> None:
    labels = LabelSet((*LABELS.names, "burned"), (*LABELS.colors, (0, 0, 0)), (*LABELS.ground_cover, True))
    rules, errors = FusionRules(support=0.0, block_cells=1), LabelErrors(np.eye(7), INDEPENDENT)
    grid_map = EvidenceMap(GRID, PRIOR, labels, rules, errors)
    frame = votes(Label.TREE, cells=[(0, 0)])
    counts = np.zeros((1, 8), np.uint32)
    counts[0, 7] = 40
    for camera in ("north", "south"):
        grid_map.add(replace(frame, counts=counts, source=camera))
    burned = grid_map.layers()
    assert (burned.code[0, 0], burned.life_form[0, 0]) == (99, LifeForm.BURNED)
    day = 86400 * 10**9
    assert grid_map.layers(at_ns=NOW * 10**9 + 179 * day).code[0, 0] == 99
    grown = grid_map.layers(at_ns=NOW * 10**9 + 181 * day)
    assert (grown.code[0, 0], grown.life_form[0, 0], grown.changed[0, 0]) == (101, LifeForm.GRASS, True)


def test_cells_of_two_forms_keep_the_usual_one_until_another_is_sure() -> None:
    assert fuel_map(votes(Label.SHRUB, pixels=1), odds=100.0).layers().life_form[1, 0] == LifeForm.GRASS
    sure = fuel_map(*(votes(Label.SHRUB, NOW + k * HOUR) for k in range(3))).layers()
    assert (sure.life_form[1, 0], sure.code[1, 0], sure.changed[1, 0]) == (LifeForm.SHRUB, 121, False)


def test_the_probability_of_a_changed_cell_is_that_of_its_new_form() -> None:
    trees = [votes(Label.TREE, NOW + k * HOUR) for k in range(3)]
    for weight, sure in ((2.5, True), (1000.0, False)):
        layers = fuel_map(*trees, prior_evidence=weight).layers()
        assert layers.changed[0, 0]
        assert bool(layers.p_max[0, 0] > 0.5) == sure


def looks_of(bearing: float, source: str, second: float = NOW) -> CellVotes:
    return votes(Label.TREE, second, source, visibility=visibility(6, bearing=bearing))


def test_two_cameras_of_one_tower_are_one_view_and_two_sides_are_two() -> None:
    systematic = LabelErrors(ASSUMED.shares, LabelCorrelation(cell=0.7, stand=0.1, view=0.7, network=0.2))
    one, same, other = (
        fuel_map(*of, errors=systematic).layers().evidence
        for of in (
            [looks_of(0.1, "north")],
            [looks_of(0.1, "north"), looks_of(0.2, "north_wide")],
            [looks_of(0.1, "north"), looks_of(3.0, "south")],
        )
    )
    np.testing.assert_allclose(same, one, rtol=1e-3)
    np.testing.assert_allclose(other, one * 2 / (1 + 0.2 / 0.7), rtol=1e-3)


def test_frames_of_a_view_say_less_the_more_its_errors_are_the_same() -> None:
    hours = [looks_of(1.0, "north", NOW + k * HOUR) for k in range(4)]
    for view in (0.0, 0.2, 0.5):
        errors = LabelErrors(ASSUMED.shares, LabelCorrelation(cell=0.5, stand=0.1, view=view, network=0.0))
        once, often = (fuel_map(*of, errors=errors).layers().evidence for of in (hours[:1], hours))
        np.testing.assert_allclose(often, once * 4 / (1 + 3 * view / 0.5), rtol=1e-3)


def test_systematic_errors_of_one_view_never_change_a_cell() -> None:
    """However long one tower says so, the prior stands, where errors correlate as they are assumed to."""
    errors = LabelErrors(ASSUMED.shares, LabelCorrelation(cell=0.78, stand=0.33, view=0.78, network=0.34))
    shrub_or_tree = [0, 0, 12, 28, 0, 0, 0]
    frames = [votes(shrub_or_tree, NOW + k * HOUR, visibility=visibility(6)) for k in range(30)]
    assert not fuel_map(*frames, errors=errors, support=FusionRules().support).layers().changed[0, 0]
    assert fuel_map(*frames).layers().changed[0, 0]


def test_a_view_says_what_it_shows_of_late() -> None:
    """Years of shrubs do not outweigh that they are gone: the newest epochs of a view stand in place of older ones."""
    shrubs = [votes(Label.SHRUB, NOW + k * EPOCH_S) for k in range(30)]
    grass = [votes(Label.GRASS, NOW + k * EPOCH_S) for k in (30, 31)]
    assert not fuel_map(*shrubs, grass[0]).layers().changed[0, 0]
    gone = fuel_map(*shrubs, *grass)
    assert (gone.layers().code[0, 0], gone.layers().changed[0, 0]) == (102, True)
    late = fuel_map(*grass, *shrubs[::-1])
    for name in ("shown", "best", "span", "epochs"):
        np.testing.assert_array_equal(late.tile_state((0, 0))[name], gone.tile_state((0, 0))[name])


def test_a_burn_voids_what_was_known_and_lives_for_a_time() -> None:
    cells = np.zeros(GRID.shape, bool)
    cells[:, :2] = True
    grid_map = fuel_map(votes(Label.TREE, NOW - HOUR), votes(Label.TREE, NOW - 3 * HOUR))
    grid_map.burn(cells, NOW * 10**9)
    grid_map.add(votes(Label.TREE, NOW - 5 * HOUR, "late"))
    layers = grid_map.layers()
    np.testing.assert_array_equal(layers.code, [[99, 99, 165], [99, 91, 183]])
    np.testing.assert_array_equal(layers.changed, [[True, True, False], [True, False, False]])
    assert not layers.evidence[0, 0]
    regrown = grid_map.layers(at_ns=(NOW + 200 * 86400) * 10**9)
    np.testing.assert_array_equal(regrown.code, [[101, 101, 165], [101, 91, 183]])
    assert regrown.changed[0, 0]
    for hours in (1, 3, 5, 7):
        grid_map.add(votes(Label.SHRUB, NOW + 200 * 86400 + hours * HOUR, cells=[(0, 0), (0, 1)]))
    # The shrubs are back: so is the prior's code of each cell.
    back = grid_map.layers()
    np.testing.assert_array_equal(back.code[0], CODES[0])
    assert not back.changed[0].any()


def test_state_in_tiles_comes_back() -> None:
    grid = GridGeometry(0.0, 2000.0, 30.0, TILE + 5, 2 * TILE + 3)
    codes = np.full(grid.shape, 145, np.int16)
    original = EvidenceMap(grid, FuelPrior(codes, grid), LABELS)
    rows, cols = (index.ravel().astype(np.int32) for index in np.indices(grid.shape))
    counts = np.zeros((len(rows), len(LABELS)), np.uint32)
    counts[:, Label.TREE] = np.arange(len(rows)) % 7
    for second in (NOW, NOW + HOUR):
        original.add(CellVotes(grid, rows, cols, counts, np.zeros(len(rows), np.float32), second * 10**9, "north"))
    keys = original.tiles_of((TILE - 1, 0, 2, TILE + 1))
    assert keys == [(0, 0), (0, 1), (1, 0), (1, 1)]
    restored = EvidenceMap(grid, FuelPrior(codes, grid), LABELS)
    tiles = original.tiles_of((0, 0, *grid.shape))
    assert tiles[-1] == (2, 1)
    for key in tiles:
        restored.load_tile(key, original.tile_state(key))
    assert restored.newest_ns == original.newest_ns
    for name, layer in vars(original.layers()).items():
        np.testing.assert_array_equal(vars(restored.layers())[name], layer, err_msg=name)
    part = original.layers((3, 7, 20, 11))
    np.testing.assert_array_equal(part.code, original.layers().code[3:23, 7:18])


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (replace(votes(Label.TREE), geometry=GRID.translated(30, 0)), "votes of north are on"),
        (votes(Label.TREE, -1), "stamp -1000000000 ns"),
        (votes(Label.TREE, 2**32), "1970 to 2106"),
    ],
)
def test_votes_that_cannot_be_taken(frame: CellVotes, message: str) -> None:
    with pytest.raises(ImageError, match=message):
        fuel_map().add(frame)


def test_a_camera_s_votes_are_weighed_by_the_errors_of_its_own_head() -> None:
    shares = ASSUMED.shares.copy()
    shrub, tree = LifeForm.SHRUB - 1, LifeForm.TREE - 1
    shares[[shrub, tree]] = shares[[tree, shrub]]  # a head that calls shrub what is tree, and tree what is shrub
    turned = LabelErrors(shares, INDEPENDENT)
    mixed = EvidenceMap(GRID, PRIOR, LABELS, FusionRules(support=24.0), TRUSTED, errors_of={"north": turned})
    for second in (NOW, NOW + HOUR):
        mixed.add(votes(Label.SHRUB, second, "north"))
    assert mixed.layers().life_form[0, 0] == LifeForm.TREE
    other = EvidenceMap(GRID, PRIOR, LABELS, FusionRules(support=24.0), TRUSTED, errors_of={"south": turned})
    for second in (NOW, NOW + HOUR):
        other.add(votes(Label.SHRUB, second, "north"))
    assert other.layers().life_form[0, 0] == LifeForm.SHRUB


def test_older_frames_of_another_form_are_no_witnesses() -> None:
    shrubs = [votes(Label.SHRUB, NOW - k * HOUR, camera) for k in (3, 5) for camera in ("north", "south")]
    trees = [votes(Label.TREE, NOW + k) for k in range(40)]
    assert not fuel_map(*shrubs, *trees).layers().changed[0, 0]
    assert fuel_map(*shrubs, *trees, votes(Label.TREE, NOW + HOUR)).layers().changed[0, 0]
