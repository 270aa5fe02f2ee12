import numpy as np
import pytest
from scenes.traced_votes import cast_votes

from ltm_core.base.errors import ImageError
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem

pytestmark = pytest.mark.kernel

# Straight down from 10 m: pixel (row, col) sees (col * 10, -row * 10).
CAMERA = Camera(3, 2, 1.0, 1.0, 0.0, 0.0)
DOWN = Pose.from_angles((0.0, 0.0, 10.0), 0.0, -90.0)
DEPTH = np.full((2, 3), 10.0, np.float32)
FUEL = GridGeometry(-5.0, 5.0, 20.0, 2, 1)  # columns 0 and 1 of pixels are in its first cell
DEM = Dem(np.array([[7, 7, 9], [7, 7, 9]], np.float32), GridGeometry(-15.0, 15.0, 20.0, 3, 2))
VOTES_FOR = np.array([False, True, True, False])


def cast(labels: list[list[int]], depth: np.ndarray = DEPTH, **options: float) -> CellVotes:
    ranges = RangeImage.from_depth(depth, CAMERA, DOWN)
    return cast_votes(ranges, np.array(labels, np.uint8), FUEL, DEM, VOTES_FOR, 77, "north", **options)


def test_counts_by_cell_and_class() -> None:
    votes = cast([[1, 2, 2], [2, 2, 1]])
    assert (votes.rows.tolist(), votes.cols.tolist()) == ([0, 0], [0, 1])
    assert votes.counts.tolist() == [[0, 1, 3, 0], [0, 1, 1, 0]]
    assert (votes.counts.dtype, votes.rows.dtype, votes.z.dtype) == (np.uint32, np.int32, np.float32)
    assert (votes.stamp_ns, votes.source, votes.geometry) == (77, "north", FUEL)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cols": [0]}, "differ in length"),
        ({"z": [1.0, 2.0, 3.0]}, "differ in length"),
        ({"counts": [[1, 2]]}, "differ in length"),
        ({"counts": [1, 2]}, "differ in length"),
        ({"cols": [0, 2]}, r"north name cell \(0, 2\), outside a fuel grid of \(1, 2\)"),
        ({"rows": [-1, 0]}, r"cell \(-1, 0\)"),
    ],
)
def test_votes_that_contradict_themselves(changes: dict[str, list], message: str) -> None:
    values = {"rows": [0, 0], "cols": [0, 1], "counts": [[1, 0], [0, 2]], "z": [1.0, 2.0]} | changes
    with pytest.raises(ImageError, match=message):
        CellVotes(FUEL, **{name: np.array(value) for name, value in values.items()}, stamp_ns=0, source="north")


@pytest.mark.parametrize("north", [-31.0, -45.0, -59.5, 12.0, 44.0])
def test_a_reach_that_covers_all_pixels_leaves_none_out(north: float) -> None:
    """Wherever the camera stands in the grid: its window of cells is never a row or column too small."""
    grid = GridGeometry(-90.0, 60.0, 30.0, 6, 4)
    pose = Pose.from_angles((north / 3, north, 10.0), 0.0, -90.0)
    ranges = RangeImage.from_depth(DEPTH, CAMERA, pose)
    labels = np.ones((2, 3), np.uint8)
    near, all_of_it = (
        cast_votes(ranges, labels, grid, DEM, VOTES_FOR, 77, "north", reach) for reach in (26.0, float("inf"))
    )
    assert all_of_it.counts.sum() > 0
    np.testing.assert_array_equal(near.counts, all_of_it.counts)
    np.testing.assert_array_equal(near.rows, all_of_it.rows)


def test_classes_that_are_no_ground_cover_do_not_vote() -> None:
    votes = cast([[0, 3, 4], [255, 1, 200]])
    assert votes.counts.tolist() == [[0, 1, 0, 0]]
    assert votes.cols.tolist() == [0]


def test_sky_and_unknown_do_not_vote() -> None:
    depth = DEPTH.copy()
    depth[0, 0], depth[1, 2] = np.inf, np.nan
    assert cast([[1, 1, 1], [1, 1, 1]], depth).counts.sum() == 4


def test_max_range_is_along_the_ray() -> None:
    # Slant ranges: 10, 14.14, 22.36 in the first row, 14.14, 17.32, 24.49 in the second.
    votes = cast([[1, 1, 1], [2, 2, 2]], max_range=17.0)
    assert votes.counts.tolist() == [[0, 2, 1, 0]]
    assert cast([[1, 1, 1], [2, 2, 2]], max_range=9.0).counts.shape == (0, 4)


def test_pixels_outside_the_grid_do_not_vote() -> None:
    ranges = RangeImage.from_depth(DEPTH, CAMERA, DOWN)
    labels = np.ones((2, 3), np.uint8)
    votes = cast_votes(ranges, labels, FUEL.translated(20.0, 10.0), DEM, VOTES_FOR, 0, "north")
    # The grid now spans 15..55 by -5..15: of all pixels only (20, 0) lies on it.
    assert votes.counts.tolist() == [[0, 1, 0, 0]]
