import numpy as np
import pytest
from scenes.depth_scene import CAMERA, TREE, depth_scene

from ltm_core.base.types import BoolArray
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.topodepth import DepthSource, FusedDepth, FusionVerdict, fuse
from ltm_core.depth.unseen_terrain import hidden_at, mostly_unknown, with_labelled_sky
from ltm_core.vision.labels import LabelSet

CLASSES = ClassPriors.of(LabelSet.load())


def mast() -> BoolArray:
    """A tenth of the picture: from the sky down to the near ground, and a caption on top."""
    hidden = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
    hidden[:, 300:370] = True
    hidden[:12] = True
    return hidden


def fused(hidden: BoolArray | None, given: BoolArray | None = None, spoilt: bool = True) -> FusedDepth:
    """With a mast that the photo, the network and the labels show; `given`: the mask that fusion is told."""
    scene = depth_scene()
    photo, labels, inverse = scene.photo.copy(), scene.labels.copy(), scene.network().values.copy()
    if hidden is not None and spoilt:
        photo[hidden], labels[hidden] = (np.arange(hidden.sum()) % 7 * 30)[:, None], TREE
        inverse[hidden_at(hidden, *inverse.shape)] = inverse.max() * 2
    if given is not None:
        labels[given] = 255
    return fuse(scene.traced, NetworkDepth(inverse, "relative_inverse"), photo, labels, CLASSES, hidden=given)


def test_hidden_pixels_have_no_depth_and_spoil_none() -> None:
    hidden, plain = mast(), fused(None)
    found = fused(hidden, hidden)
    assert found.verdict is plain.verdict is FusionVerdict.OK
    for values in (found.depth, found.sigma, found.ground):
        assert np.isnan(values[hidden]).all()
    assert (found.source[hidden] == DepthSource.UNKNOWN).all()
    assert found.fit is not None
    assert plain.fit is not None
    assert found.fit.line is not None
    assert plain.fit.line is not None
    assert found.fit.line.scale == pytest.approx(plain.fit.line.scale, rel=0.05)
    # What is seen is as without a mast, but for what filters carry a few pixels over its edge.
    clear = ~hidden_at(hidden, CAMERA.height // 20, CAMERA.width // 20).repeat(20, 0).repeat(20, 1)
    clear &= np.isfinite(plain.depth)
    assert (np.abs(found.depth[clear] / plain.depth[clear] - 1) < 0.02).mean() > 0.97
    truth = depth_scene().truth
    error = np.abs(found.depth[clear] - truth[clear]).mean()
    assert error < 1.1 * np.abs(plain.depth[clear] - truth[clear]).mean() + 0.1


def test_a_suspected_pose_and_an_unusable_picture_have_no_depth_there_either() -> None:
    scene, hidden = depth_scene(), mast()
    labels = np.where(hidden, np.uint8(255), scene.labels)
    off = fuse(scene.turned(0.8), scene.network(), scene.photo, labels, CLASSES, hidden=hidden)
    assert off.verdict is FusionVerdict.POSE_SUSPECTED
    dark = fuse(scene.traced, scene.network(), scene.photo, labels, CLASSES, hidden=hidden, unusable="night")
    assert (dark.verdict, dark.reason) == (FusionVerdict.PICTURE_UNUSABLE, "night")
    for found in (off, dark):
        assert np.isnan(found.depth[hidden]).all()
        assert np.isnan(found.measured().depth).all()
    traced = scene.traced.depth()
    np.testing.assert_array_equal(dark.depth[~hidden], traced[~hidden])
    assert np.isfinite(traced[hidden]).any(), "the tracer's own array is left as it was"


SKY, LAND = 0, 4
nan, inf = np.nan, np.inf


def test_unknown_under_sky_becomes_sky() -> None:
    depth = np.array([[nan, nan, inf, nan], [nan, nan, nan, nan], [nan, 9, nan, nan], [7, nan, 5, nan]], np.float32)
    labels = np.array([[0, 0, 0, LAND], [0, 0, 0, 0], [LAND, 0, 0, 0], [LAND, 0, LAND, 0]], np.uint8)
    found = with_labelled_sky(depth, labels, SKY)
    # The first column ends at land, the second at known ground (a lake below it is none), the fourth begins with land.
    expected = [[inf, inf, inf, nan], [inf, inf, inf, nan], [nan, 9, inf, nan], [7, nan, 5, nan]]
    np.testing.assert_array_equal(found, np.array(expected, np.float32))
    assert np.isnan(depth[0, 0])


@pytest.mark.parametrize(
    ("part", "reason"),
    [
        ((slice(0, 144), slice(0, 400)), "beyond the DEM's edge; give a coarser DEM"),
        ((slice(60, 200), slice(0, 400)), "holes"),
        ((slice(100, 240), slice(0, 400)), "next to a hole"),
        ((slice(0, 240), slice(100, 320)), "misses the DEM"),
    ],
)
def test_where_it_lies_tells_the_reason(part: tuple[slice, slice], reason: str) -> None:
    depth = np.full((240, 400), 50.0, np.float32)
    depth[part] = np.nan
    found = mostly_unknown(depth)
    assert reason in found
    assert f"{np.isnan(depth).mean():.0%}" in found
    depth[part][:, ::2] = 60.0
    assert mostly_unknown(depth) == ""
