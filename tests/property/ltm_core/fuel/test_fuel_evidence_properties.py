"""What no set of frames may do to the fuel map, whatever they hold and however they come."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes.any_votes import ASSUMED, BEGIN, CELLS, GRID, LABELS, counted, frames
from scenes.examples import examples
from scenes.traced_votes import cast_votes

from ltm_core.fuel.class_map import UNSEEN, MajorityFuelMap
from ltm_core.fuel.evidence import EPOCH_S, EVIDENCE_FIELDS, UNIT, EvidenceMap
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors, known_errors
from ltm_core.fuel.life_form import FORMS, NODATA, forms_of
from ltm_core.fuel.rules import FusionRules
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem

pytestmark = pytest.mark.kernel


def errors(cell: float, view: float) -> LabelErrors:
    correlation = LabelCorrelation(cell=cell, stand=cell / 4, view=view, network=view / 2)
    return LabelErrors(ASSUMED.shares, correlation)


LOOKING = known_errors("landscape_lite0")
"""A network that knows what cells look like: cells are judged by their neighbours in the frame too."""
assert LOOKING.appearance is not None
networks = st.sampled_from([ASSUMED, errors(0.0, 0.0), errors(0.3, 0.1), errors(1.0, 1.0), LOOKING])


def state(fuel_map: EvidenceMap) -> dict[str, np.ndarray]:
    return fuel_map.tile_state((0, 0))


def assert_same(found: EvidenceMap, expected: EvidenceMap) -> None:
    for name, values in state(expected).items():
        np.testing.assert_array_equal(state(found)[name], values, err_msg=name)


@examples(15, in_fuzz=60)
@given(st.lists(frames(), min_size=2, max_size=8), st.randoms(use_true_random=False), networks)
def test_the_order_of_frames_changes_no_bit(of: list[CellVotes], random: object, network: LabelErrors) -> None:
    shuffled = list(of)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert_same(counted(*shuffled, network=network), counted(*of, network=network))


@examples(12, in_fuzz=40)
@given(st.lists(frames(), min_size=1, max_size=6), networks)
def test_unseen_cells_are_the_priors_bit_for_bit(of: list[CellVotes], network: LabelErrors) -> None:
    unseen = np.ones(GRID.shape, bool)
    for frame in of:
        unseen[frame.rows, frame.cols] = False
    before, after = counted(network=network).layers(), counted(*of, network=network).layers()
    for name, layer in vars(before).items():
        np.testing.assert_array_equal(vars(after)[name][unseen], layer[unseen], err_msg=name)
    assert not any(values[: GRID.height, : GRID.width][unseen].any() for values in state(counted(*of)).values())


@examples(15, in_fuzz=60)
@given(st.lists(frames(), max_size=8), networks)
def test_the_code_is_the_priors_where_its_life_form_holds(of: list[CellVotes], network: LabelErrors) -> None:
    layers = counted(*of, network=network).layers()
    known = layers.prior != NODATA
    agrees = np.take_along_axis(forms_of(layers.prior), (layers.life_form.astype(int) - 1)[..., None] % 7, -1)[..., 0]
    np.testing.assert_array_equal(layers.code[known & agrees], layers.prior[known & agrees])
    np.testing.assert_array_equal(layers.changed[known], ~agrees[known])
    masked = np.isin(layers.prior, FusionRules().mask)
    np.testing.assert_array_equal(layers.code[masked], layers.prior[masked])


@examples(12, in_fuzz=40)
@given(frames(), st.integers(2, 200), st.integers(0, 3599))
def test_frames_of_an_hour_are_one_look(frame: CellVotes, repeats: int, seconds: int) -> None:
    """However many come, they are worth no more than two looks of that view; of a network that errs in every frame
    alike, no more than one.
    """
    assume(frame.stamp_ns // (10**9 * EPOCH_S) == (frame.stamp_ns // 10**9 + seconds) // EPOCH_S)
    stamps = frame.stamp_ns + np.linspace(0, seconds, repeats).astype(int) * 10**9
    many = [replace(frame, stamp_ns=int(stamp)) for stamp in stamps]
    alike, apart = errors(0.5, 0.5), errors(0.5, 0.1)
    once, often = (counted(*of, network=alike).layers() for of in ([frame], many))
    np.testing.assert_allclose(often.evidence, once.evidence, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(often.p_max, once.p_max, rtol=1e-4)
    once, often = (counted(*of, network=apart).layers() for of in ([frame], many))
    assert (often.evidence <= 2 / 1.2 * once.evidence + 1e-4).all()


@examples(15, in_fuzz=60)
@given(st.lists(frames(), max_size=12), networks)
def test_evidence_is_bounded_and_never_negative(of: list[CellVotes], network: LabelErrors) -> None:
    fuel_map = counted(*of, network=network)
    layers = fuel_map.layers()
    assert (layers.evidence >= 0).all()
    correlation = network.correlation
    if correlation.network > 0:
        most = FusionRules().frame_cap * correlation.cell / correlation.network
        assert (layers.evidence <= most * 1.001).all()
    for layer in (layers.p_max, layers.entropy):
        assert np.nan_to_num(layer, nan=0.5).min() >= 0
        assert np.nan_to_num(layer, nan=0.5).max() <= 1 + 1e-6


@examples(12, in_fuzz=40)
@given(st.lists(frames(), min_size=1, max_size=5), frames())
def test_a_hostile_frame_moves_no_cell_but_its_own(of: list[CellVotes], hostile: CellVotes) -> None:
    elsewhere = np.ones(GRID.shape, bool)
    elsewhere[hostile.rows, hostile.cols] = False
    quiet, disturbed = counted(*of), counted(*of, hostile)
    for name in EVIDENCE_FIELDS:
        before, after = (state(m)[name][: GRID.height, : GRID.width] for m in (quiet, disturbed))
        np.testing.assert_array_equal(after[elsewhere], before[elsewhere], err_msg=name)
    at = max(quiet.newest_ns, disturbed.newest_ns)
    one, other = quiet.layers(at_ns=at), disturbed.layers(at_ns=at)
    for name in ("code", "life_form", "evidence", "p_max"):
        np.testing.assert_array_equal(vars(other)[name][elsewhere], vars(one)[name][elsewhere], err_msg=name)


def test_counts_of_a_forged_frame_do_not_overflow() -> None:
    rows, cols = (np.array(index, np.int32) for index in zip(*CELLS, strict=True))
    counts = np.full((len(CELLS), len(LABELS)), 2**32 - 1, np.uint32)
    counts[:, 3] = 0
    huge = CellVotes(GRID, rows, cols, counts, np.zeros(len(CELLS), np.float32), BEGIN * 10**9, "north")
    layers = counted(huge).layers()
    assert (layers.evidence <= FusionRules().frame_cap + FORMS / (2 * UNIT)).all()  # of each form rounded
    full = state(counted(huge))
    full["shown"][...] = 2**32 - 1
    fuel_map = counted()
    fuel_map.load_tile((0, 0), full)
    fuel_map.add(huge)
    assert state(fuel_map)["shown"].max() == 2**32 - 1
    assert fuel_map.layers().evidence.max() == pytest.approx(0, abs=100)


CAMERA = Camera(7, 5, 4.0, 4.5, 2.5, 2.0, (-0.05, 0.01, 0.0, 0.001, 0.0))
DEM = Dem(np.arange(120, dtype=np.float32).reshape(10, 12), GridGeometry(-180.0, 150.0, 30.0, 12, 10))
FUEL = GridGeometry(-90.0, 60.0, 30.0, 6, 4)
ranges_ = arrays(
    np.float32, (5, 7), elements=st.one_of(st.floats(0.125, 300, width=32), st.sampled_from([np.inf, np.nan]))
)
labels_ = arrays(np.uint8, (5, 7), elements=st.sampled_from([0, 1, 2, 3, 4, 9, 255]))
poses = st.builds(
    Pose.from_angles,
    st.tuples(st.floats(-60, 60), st.floats(-60, 60), st.floats(0, 90)),
    st.floats(0, 360),
    st.floats(-90, 10),
    st.floats(-30, 30),
)
voting = st.tuples(st.just(False), *[st.booleans()] * 4)


@settings(max_examples=120, deadline=None)
@given(ranges_, labels_, poses, voting, st.sampled_from([np.inf, 150.0, 20.0]))
def test_counted_by_hand(
    slant: np.ndarray, labels: np.ndarray, pose: Pose, votes_for: tuple[bool, ...], max_range: float
) -> None:
    ranges = RangeImage(slant, CAMERA, pose, 1e-4)
    votes = cast_votes(ranges, labels, FUEL, DEM, np.array(votes_for), 5, "north", max_range)

    points = ranges.points()
    count: Counter[tuple[int, int, int]] = Counter()
    for v in range(5):
        for u in range(7):
            label, (x, y, _) = int(labels[v, u]), points[v, u].astype(float)
            if label >= 5 or not votes_for[label] or not slant[v, u] <= max_range or np.isinf(slant[v, u]):
                continue
            col, row = int((x + 90) // 30), int((60 - y) // 30)
            if 0 <= row < 4 and 0 <= col < 6:
                count[row, col, label] += 1

    cells = list(zip(votes.rows.tolist(), votes.cols.tolist(), strict=True))
    assert cells == sorted({(row, col) for row, col, _ in count})
    for (row, col), counts, z in zip(cells, votes.counts, votes.z, strict=True):
        assert counts.tolist() == [count[row, col, label] for label in range(5)]
        # The DEM's surface is a plane: 1 m a cell eastwards, 12 m a cell southwards; fuel edges are its own.
        assert z == (row + 3) * 12 + col + 3

    fuel = MajorityFuelMap(FUEL, 5)
    fuel.add(votes)
    for row, col in np.ndindex(FUEL.shape):
        here = [count[row, col, label] for label in range(5)]
        assert fuel.classes()[row, col] == (here.index(max(here)) if any(here) else UNSEEN)
