from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes.depth_scene import CAMERA, STAND_HEIGHT, DepthScene, depth_scene

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.depth.fusion_config import FusionConfig, fusion_path, load_fusion_config
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.topodepth import DepthSource, FusedDepth, FusionVerdict, fuse
from ltm_core.geometry.range_image import RangeImage
from ltm_core.storage.config_io import load_yaml
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import Label, LabelSet
from ltm_core.vision.manifest import NetworkManifest

CLASSES = ClassPriors.of(LabelSet.load())


def fused(scene: DepthScene, network: NetworkDepth | None, labels: UInt8Array | None = None) -> FusedDepth:
    return fuse(scene.traced, network, scene.photo, labels, CLASSES)


def rmse(depth: Float32Array, truth: Float32Array, where: BoolArray) -> float:
    counted = where & np.isfinite(depth) & np.isfinite(truth)
    return float(np.sqrt(np.mean((depth[counted] - truth[counted]) ** 2)))


@pytest.mark.parametrize(("labelled", "left"), [(True, 0.5), (False, 0.8)])
def test_trees_that_the_dem_does_not_know_are_seen(labelled: bool, left: float) -> None:
    """Without labels the trees stand among the ground that the network is fitted to, and less is seen of them."""
    scene = depth_scene()
    result = fused(scene, scene.network(), scene.labels if labelled else None)
    assert result.verdict is FusionVerdict.OK
    traced = rmse(scene.traced.depth(), scene.truth, scene.stand)
    assert rmse(result.depth, scene.truth, scene.stand) < left * traced
    seen = np.isin(result.source, (DepthSource.NETWORK, DepthSource.BOTH))
    assert seen[scene.stand].mean() > 1.0 - left
    np.testing.assert_array_equal(result.ground, scene.traced.depth())


def test_where_nothing_changed_the_terrain_stays_and_beats_the_network() -> None:
    scene = depth_scene()
    result = fused(scene, scene.network(), scene.labels)
    assert result.fit is not None
    far = np.isfinite(scene.truth) & (scene.truth > 800) & ~scene.stand
    network = np.repeat(np.repeat(1 / np.maximum(result.fit.inverse, 1e-5), 4, 0), 4, 1)
    assert rmse(result.depth, scene.truth, far) < 0.1 * rmse(network, scene.truth, far)
    error = np.abs(result.depth[far] - scene.truth[far]) / scene.truth[far]
    assert np.median(error) < 0.002
    # The height that grass is taken to have, under a grazing view, and what of outlines a soft network blurs.
    assert np.quantile(error, 0.98) < 0.06
    assert (error > 0.1).mean() < 0.004


def test_sigma_says_how_wrong_the_depth_is() -> None:
    scene = depth_scene()
    result = fused(scene, scene.network(), scene.labels)
    known = np.isfinite(result.depth) & np.isfinite(scene.truth)
    assert (np.abs(result.depth[known] - scene.truth[known]) < 3 * result.sigma[known]).mean() > 0.97
    assert np.isnan(result.sigma[~np.isfinite(result.depth)]).all()


@pytest.mark.parametrize("kind", ["affine_invariant", "metric"])
def test_networks_of_the_other_kinds_are_fitted_too(kind: str) -> None:
    scene = depth_scene()
    inverse = (scene.network(noise=0.01, scale=1.0, shift=0.0)).values
    metres = 1 / np.maximum(inverse, 2e-4)
    values = metres * 1.7 if kind == "metric" else 0.01 * metres - 0.5
    result = fused(scene, NetworkDepth(values.astype(np.float32), kind), scene.labels)  # type: ignore[arg-type]
    assert result.verdict is FusionVerdict.OK
    assert result.fit is not None
    assert result.fit.line is not None
    if kind == "metric":
        assert np.exp(result.fit.line.shift) == pytest.approx(1 / 1.7, rel=0.02)
    else:
        assert result.fit.line.scale == pytest.approx(100.0, rel=0.05)
    assert rmse(result.depth, scene.truth, scene.stand) < 0.6 * rmse(scene.traced.depth(), scene.truth, scene.stand)


@pytest.mark.parametrize("kind", ["relative_inverse", "affine_invariant", "metric"])
def test_noise_is_no_depth(kind: str) -> None:
    """Numbers that have nothing to do with the terrain, over decades: named, and the terrain's depth stays."""
    scene = depth_scene()
    noise = (1e4 * np.random.default_rng(4).random((32, 48)) ** 6).astype(np.float32)
    result = fused(scene, NetworkDepth(noise, kind), scene.labels)  # type: ignore[arg-type]
    assert result.verdict is FusionVerdict.NETWORK_UNUSABLE
    assert "explains only" in result.reason or "fit one scale" in result.reason or "against" in result.reason
    assert rmse(result.depth, scene.traced.depth(), ~scene.stand & np.isfinite(scene.traced.range)) < 20.0


@pytest.mark.parametrize("turn", [0.6, -1.0, 2.0])
def test_a_wrong_pose_is_suspected_and_nothing_is_fused(turn: float) -> None:
    scene = depth_scene()
    wrong = scene.turned(turn)
    result = fuse(wrong, scene.network(), scene.photo, scene.labels, CLASSES)
    assert result.verdict is FusionVerdict.POSE_SUSPECTED
    assert result.pose.pitch_deg == pytest.approx(-turn, abs=0.15)
    assert "deg of pitch" in result.reason
    np.testing.assert_array_equal(result.depth, wrong.depth())
    assert set(np.unique(result.source)) <= {DepthSource.TERRAIN, DepthSource.SKY, DepthSource.UNKNOWN}
    assert np.isnan(result.sigma).all()


def test_without_terrain_and_with_an_empty_sky() -> None:
    scene = depth_scene()
    for value, source in ((np.nan, DepthSource.UNKNOWN), (np.inf, DepthSource.SKY)):
        nothing = replace(scene.traced, range=np.full_like(scene.traced.range, value))
        result = fuse(nothing, scene.network(), scene.photo, scene.labels, CLASSES)
        assert result.verdict is FusionVerdict.NO_TERRAIN
        assert (result.source == source).all()


def test_holes_of_the_dem_stay_holes_or_are_filled_by_the_network_alone() -> None:
    scene = depth_scene()
    holed = scene.traced.range.copy()
    holed[250:300, 100:220] = np.nan
    result = fuse(replace(scene.traced, range=holed), scene.network(), scene.photo, scene.labels, CLASSES)
    assert result.verdict is FusionVerdict.OK
    inside = result.source[255:295, 110:210]
    assert np.isin(inside, (DepthSource.NETWORK, DepthSource.UNKNOWN)).all()
    filled = result.depth[255:295, 110:210][inside == DepthSource.NETWORK]
    true = scene.truth[255:295, 110:210][inside == DepthSource.NETWORK]
    assert len(filled) > 0.5 * inside.size
    assert np.median(np.abs(filled / true - 1)) < 0.1


def test_land_beyond_the_dem_stays_unknown() -> None:
    """It reaches up to the sky, so no ground beyond it holds the network's scale."""
    scene = depth_scene()
    cut = scene.traced.range.copy()
    far = np.isfinite(cut) & (cut > np.percentile(cut[np.isfinite(cut)], 80))
    cut[far] = np.nan
    result = fuse(replace(scene.traced, range=cut), scene.network(), scene.photo, scene.labels, CLASSES)
    assert far.sum() > 1000
    assert np.isnan(result.depth[far]).mean() > 0.99
    assert (result.source[far] == DepthSource.UNKNOWN).mean() > 0.99
    assert np.isnan(result.sigma[result.source == DepthSource.UNKNOWN]).all()


def without_sky(scene: DepthScene) -> RangeImage:
    """As the tracer gives it where there may be land beyond the DEM."""
    return replace(
        scene.traced, range=np.where(np.isposinf(scene.traced.range), np.float32(np.nan), scene.traced.range)
    )


def test_labels_say_what_is_sky_where_land_may_lie_beyond_the_dem() -> None:
    scene = depth_scene()
    known = fuse(scene.traced, scene.network(), scene.photo, scene.labels, CLASSES)
    found = fuse(without_sky(scene), scene.network(), scene.photo, scene.labels, CLASSES)
    np.testing.assert_array_equal(found.source == DepthSource.SKY, known.source == DepthSource.SKY)
    np.testing.assert_array_equal(found.depth, known.depth)
    # Without labels nobody knows.
    unlabelled = fuse(without_sky(scene), scene.network(), scene.photo, None, CLASSES)
    assert not np.isinf(unlabelled.depth).any()


def test_a_photo_that_is_mostly_unknown_is_not_just_ok() -> None:
    scene = depth_scene()
    nearest = np.quantile(scene.traced.range[np.isfinite(scene.traced.range)], 0.3)
    near = np.where(scene.traced.range < nearest, scene.traced.range, np.float32(np.nan))
    labels = np.full(scene.labels.shape, Label.BARE, np.uint8)
    result = fuse(replace(scene.traced, range=near), None, scene.photo, labels, CLASSES)
    share = np.isnan(result.depth).mean()
    assert 0.5 < share < 1
    assert result.verdict is FusionVerdict.MOSTLY_UNKNOWN
    assert f"{share:.0%}" in result.reason
    assert "beyond the DEM's edge" in result.reason
    assert result.info()["verdict"] == "mostly_unknown"


def test_a_canopy_raster_is_taken_where_trees_are_labelled_and_both_hits_are_kept() -> None:
    scene = depth_scene()
    rows, cols = np.mgrid[0 : scene.dem.geometry.height, 0 : scene.dem.geometry.width]
    x, y = scene.dem.geometry.to_map(rows, cols)
    stand = (np.abs(x - 60.0) < 70.0) & (np.abs(y - 330.0) < 45.0)
    # A second stand in the raster has been felled since.
    felled = (np.abs(x + 120.0) < 40.0) & (np.abs(y - 330.0) < 45.0)
    grown = np.where(stand | felled, scene.dem.elevation + np.float32(STAND_HEIGHT), scene.dem.elevation)
    over = TerrainTracer(replace(scene.dem, elevation=grown.astype(np.float32))).trace(CAMERA, scene.traced.pose)
    result = fuse(scene.traced, None, scene.photo, scene.labels, CLASSES, surface=over)
    assert rmse(result.depth, scene.truth, scene.stand) < 0.2 * rmse(scene.traced.depth(), scene.truth, scene.stand)
    with np.errstate(invalid="ignore"):
        gone = np.isfinite(scene.truth) & ~scene.stand & (over.depth() < scene.traced.depth() - 5.0)
    gone &= scene.labels == 1
    assert gone.sum() > 500
    assert np.abs(result.depth[gone] / scene.truth[gone] - 1).max() < 0.05
    assert (result.ground[scene.stand] > result.depth[scene.stand]).mean() > 0.9


def test_the_shipped_network_brings_its_own_and_another_takes_the_defaults(tmp_path: Path) -> None:
    manifest = NetworkManifest.find("landscape_lite0_depth")
    assert fusion_path(manifest).is_file()
    assert load_fusion_config(manifest) == load_yaml(fusion_path(manifest), FusionConfig)
    copy = tmp_path / "other.yaml"
    copy.write_text((manifest.folder / f"{manifest.name}.yaml").read_text().replace(manifest.name, "other", 1))
    assert load_fusion_config(NetworkManifest.load(copy)) == FusionConfig()
