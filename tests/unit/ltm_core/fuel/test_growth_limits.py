import functools

import numpy as np
import pytest

from ltm_core.base.types import Float32Array
from ltm_core.fuel.life_form import GroundLimits
from ltm_core.fuel.votes import CellVotes, VoteCaster
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_core.vision.labels import Label, LabelSet

pytestmark = pytest.mark.kernel

LABELS = LabelSet.load()
FUEL = GridGeometry(0.0, 360.0, 30.0, 16, 12)
GENTLE_DEG, STEEPEST_DEG, WALL_DEG = 25.0, 50.0, 60.0
FOOT, TOP = 210.0, 300.0
"""x between which the wall rises to the east: whole cells. West of it the slope, east of it level ground."""
CAMERA, POSE = Camera.from_fov(96, 64, 75.0), Pose.from_angles((0.0, 175.0, 120.0), 90.0, 5.0)


def hillside(wall_deg: float) -> Dem:
    """A slope of 25 degrees up to the foot of a wall; all of it rises to the east."""
    geometry = GridGeometry(-30.0, 390.0, 3.0, 180, 140)
    x = geometry.to_map(0, np.arange(geometry.width))[0]
    z = np.tan(np.radians(GENTLE_DEG)) * np.minimum(x, FOOT)
    z += np.tan(np.radians(wall_deg)) * (np.clip(x, FOOT, TOP) - FOOT)
    return Dem(np.tile(z.astype(np.float32), (geometry.height, 1)), geometry)


@functools.cache
def traced(wall_deg: float) -> tuple[Dem, Float32Array]:
    """The hillside, and its depth."""
    dem = hillside(wall_deg)
    return dem, TerrainTracer(dem, possible=NOTHING_BEYOND).trace(CAMERA, POSE).depth()


def cast(labels: np.ndarray | int, steepest_deg: float | None, wall_deg: float = WALL_DEG) -> CellVotes:
    """From above the slope's western end, looking east at all of it."""
    dem, depth = traced(wall_deg)
    image = np.broadcast_to(np.uint8(labels) if np.isscalar(labels) else labels, depth.shape)
    ground = None if steepest_deg is None else GroundLimits(steepest_deg, FUEL, dem, LABELS)
    caster = VoteCaster(FUEL, dem, LABELS.votes_table[: len(LABELS)], limits=ground)
    return caster.cast(depth, CAMERA, POSE, image, 5, "north", np.full(depth.shape, 200, np.uint8))


def same(one: CellVotes, other: CellVotes) -> bool:
    """To the last bit."""
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("rows", "cols", "counts", "z")]
    pairs += [] if one.confidence is None else [(one.confidence, other.confidence)]
    assert one.visibility is not None
    assert other.visibility is not None
    pairs += zip(one.visibility.columns(), other.visibility.columns(), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def west_of(votes: CellVotes, x: float) -> CellVotes:
    return votes.only(votes.centres()[:, 0] < x)


def on_the_wall(votes: CellVotes) -> CellVotes:
    """Cells that are the wall's alone, at the width of a cell over which the slope is taken."""
    x = votes.centres()[:, 0]
    return votes.only((x > FOOT + 30) & (x < TOP - 30))


@pytest.mark.parametrize("label", [Label.GRASS, Label.SHRUB, Label.TREE])
def test_a_wall_loses_its_plants_and_the_slope_beside_it_none(label: Label) -> None:
    plain, votes = cast(label, None), cast(label, STEEPEST_DEG)
    assert on_the_wall(plain).counts.sum() > 200
    assert len(on_the_wall(votes)) == 0
    gentle = west_of(plain, FOOT - 30)
    assert len(gentle) > 10
    assert same(gentle, west_of(votes, FOOT - 30))
    assert votes.too_steep >= on_the_wall(plain).counts.sum()


def test_water_votes_on_level_ground_alone() -> None:
    plain, votes = (cast(Label.WATER, limits, wall_deg=0.0) for limits in (None, np.inf))
    slope, level = west_of(plain, FOOT - 30), plain.only(plain.centres()[:, 0] > FOOT + 30)
    assert min(len(slope), len(level)) > 3
    assert len(west_of(votes, FOOT - 30)) == 0
    assert same(level, votes.only(votes.centres()[:, 0] > FOOT + 30))
    assert votes.too_steep >= slope.counts.sum()


def test_what_is_left_of_a_cell_does_not_stand_for_all_of_it() -> None:
    """A wall that is called tree by three pixels of four is not bare by the fourth; one that is called bare by three
    of four is."""
    mostly_trees = np.full((64, 96), Label.TREE, np.uint8)
    mostly_trees[::2, ::2] = Label.BARE
    assert len(on_the_wall(cast(mostly_trees, None))) > 3
    assert len(on_the_wall(cast(mostly_trees, STEEPEST_DEG))) == 0
    mostly_bare = np.full((64, 96), Label.BARE, np.uint8)
    mostly_bare[::2, ::2] = Label.TREE
    few = on_the_wall(cast(mostly_bare, STEEPEST_DEG))
    assert len(few) > 3
    assert few.counts[:, Label.TREE].sum() == 0
    plain = on_the_wall(cast(mostly_bare, None))
    cells = set(zip(few.rows.tolist(), few.cols.tolist(), strict=True))
    kept = [k for k, cell in enumerate(zip(plain.rows.tolist(), plain.cols.tolist(), strict=True)) if cell in cells]
    np.testing.assert_array_equal(few.counts[:, Label.BARE], plain.counts[kept][:, Label.BARE])


def test_frames_of_one_camera_and_each_alone_have_the_same_votes() -> None:
    """Of cells that were asked about before, and of those that a frame is the first to see."""
    dem, depth = traced(WALL_DEG)
    labels, votes_for = np.full(depth.shape, Label.TREE, np.uint8), LABELS.votes_table[: len(LABELS)]
    near = np.where(np.arange(96) < 40, depth, np.nan).astype(np.float32)

    def caster() -> VoteCaster:
        limits = GroundLimits(STEEPEST_DEG, FUEL, dem, LABELS)
        return VoteCaster(FUEL, dem, votes_for, limits=limits)

    one = caster()
    for frame in (near, depth, near, depth):
        alone, among = (c.cast(frame, CAMERA, POSE, labels, 5, "north") for c in (caster(), one))
        assert same(alone, among)
        assert alone.too_steep == among.too_steep > 0


def test_ground_of_unknown_height_has_no_limit() -> None:
    dem = hillside(WALL_DEG)
    elevation = dem.elevation.copy()
    elevation[:, 60:] = np.nan
    ground = GroundLimits(20.0, FUEL, Dem(elevation, dem.geometry), LABELS)
    assert not ground.learn(np.array([10, 11, FUEL.width + 12])).any()
    assert ground.learn(np.array([3]))[[Label.TREE, Label.WATER]].all()
