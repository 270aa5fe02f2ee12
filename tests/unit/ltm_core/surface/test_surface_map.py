from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes.terrain_hillside import (
    BARE,
    BEGIN,
    CAMERA,
    GEOMETRY,
    HOUR,
    LOWERED,
    PATCH,
    PLACES,
    RAISED,
    RULES,
    changed_share,
    dem,
    frame,
    surface_map,
)

from ltm_core.base.errors import ConfigError, ImageError, PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.surface.tile_pool import TilePool, schema_of


def test_two_cameras_move_the_surface_and_are_named() -> None:
    surface = surface_map(BARE.copy())
    surface.add(frame(RAISED, "west"))
    surface.add(frame(RAISED, "east", 0.5))
    changed = surface.decide()
    layers = surface.layers()
    seen = layers.observed & PATCH
    assert seen.sum() > 300
    assert changed_share(surface) > 0.9
    assert set(np.unique(layers.change[seen])) <= {ChangeKind.NONE, ChangeKind.GROWN}
    outside = layers.observed & ~PATCH
    assert (layers.change[outside] > 0).mean() < 0.02
    was = np.abs(BARE - RAISED)[seen].mean()
    assert np.abs(layers.height - RAISED)[seen].mean() < 0.25 * was
    # Nothing else has moved by a bit, and bare earth not at all.
    assert np.array_equal(layers.height[layers.change == 0], layers.reference[layers.change == 0])
    assert np.array_equal(surface.reference.bare, dem(BARE).elevation)
    first = int(changed.rows[0]), int(changed.cols[0])
    assert int(layers.since[first]) == (BEGIN + HOUR // 2) // 1_000_000_000
    assert np.allclose(surface.heights_at(changed), layers.height[changed.rows, changed.cols])


def test_bare_earth_that_sinks_is_lowered_without_a_surface_raster() -> None:
    surface = surface_map()
    for hours in (0.0, 2.0):
        surface.add(frame(LOWERED, "west", hours))
    surface.decide()
    layers = surface.layers()
    assert changed_share(surface) > 0.9
    assert (layers.change[layers.change > 0] == ChangeKind.LOWERED).mean() > 0.95


@pytest.mark.parametrize("changed", [RAISED, LOWERED], ids=["raised", "lowered"])
def test_a_single_view_changes_nothing_however_often_it_comes(changed: Float64Array) -> None:
    surface = surface_map(BARE.copy())
    surface.add(frame(BARE, "east", 0.0))
    for minute in range(12):
        surface.add(frame(changed, "west", minute / 30))
    assert len(surface.decide().rows) == 0
    layers = surface.layers()
    assert np.array_equal(layers.height, layers.reference)


def test_what_a_camera_errs_alike_in_each_look_is_never_believed_of_it_alone() -> None:
    """It sees a place 6 m too near, under three of its sigmas, in eight looks over a day; a map that is told
    that errors are new each time takes the same looks at their word."""
    nearer = np.zeros((180, 320), np.float32)
    nearer[60:110, 140:200] = 6.0
    found = {}
    for repeats in (RULES.repeated_error_share, 0.0):
        surface = surface_map(BARE, RULES.model_copy(update={"repeated_error_share": repeats}))
        for hour in range(8):
            seen = frame(BARE, "west", 3.0 * hour, 0.01)
            surface.add(replace(seen, depth=seen.depth - nearer, sigma=np.full_like(seen.depth, 2.2)))
        surface.decide()
        layers = surface.layers()
        found[repeats] = (layers.change > 0).sum()
        assert layers.observed.sum() > 5000
    assert found[RULES.repeated_error_share] == 0
    assert found[0.0] > 100


def test_smoke_changes_nothing() -> None:
    """A plume that drifts and swells over hours, nearer than the slope behind it, seen by both cameras."""
    surface = surface_map(BARE.copy())
    rng = np.random.default_rng(5)
    for i in range(8):
        for source in PLACES:
            clear = frame(BARE, source, i * 0.6)
            u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
            centre = 40 + 30 * i + 10 * rng.random()
            plume = np.hypot((u - centre) / (25 + 3 * i), (v - 90) / 60) < 1
            way = rng.uniform(0.4, 0.8)
            surface.add(replace(clear, depth=np.where(plume, clear.depth * way, clear.depth).astype(np.float32)))
    assert len(surface.decide().rows) == 0


def test_removed_trees_are_seen_by_the_rays_that_pass_where_they_stood() -> None:
    """Canopy of a raster that is gone: also cells behind it, which only rays over the ground report."""
    surface = surface_map(RAISED)
    for source, hours in (("west", 0.0), ("east", 0.5), ("west", 2.0)):
        surface.add(frame(BARE, source, hours))
    surface.decide()
    layers = surface.layers()
    assert changed_share(surface) > 0.95
    assert (layers.change[layers.change > 0] == ChangeKind.REMOVED).mean() > 0.95
    assert np.abs(layers.height - BARE)[PATCH & layers.observed].mean() < 1.0


def test_crowns_that_rays_pass_here_and_there_still_stand() -> None:
    """One pixel of nine, the same each time, sees through leaves what is behind them."""
    surface = surface_map(RAISED)
    for source, hours in (("west", 0.0), ("east", 0.5), ("west", 2.0)):
        standing = frame(RAISED, source, hours)
        through = standing.depth.copy()
        through[1::3, 2::3] = frame(BARE, source, hours).depth[1::3, 2::3]
        surface.add(replace(standing, depth=through))
    surface.decide()
    seen = PATCH & surface.layers().observed
    assert seen.sum() > 300
    assert (surface.layers().change[seen] == 0).all()


def test_the_first_views_define_the_canopy_where_no_raster_does() -> None:
    surface = surface_map()
    for source, hours in (("west", 0.0), ("east", 0.5), ("west", 2.0), ("east", 2.5)):
        surface.add(frame(RAISED, source, hours))
    surface.decide()
    assert (surface.layers().change == 0).all(), "a standing canopy is no change"
    seen = surface.layers().observed & PATCH
    assert np.abs(surface.layers().height - RAISED)[seen].mean() < 1.0
    for source, hours in (("west", 24.0), ("east", 24.5), ("west", 26.0), ("east", 26.5)):
        surface.add(frame(BARE, source, hours))
    surface.decide()
    layers = surface.layers()
    assert changed_share(surface) > 0.8
    assert (layers.change[PATCH & layers.observed & (layers.change > 0)] == ChangeKind.REMOVED).all()


@pytest.mark.parametrize("value", [np.nan, 0.0, -50.0, np.inf])
def test_depth_that_is_none_says_nothing_false(value: float) -> None:
    surface = surface_map(BARE.copy())
    depth = np.full((CAMERA.height, CAMERA.width), value, np.float32)
    for source, hours in (("west", 0.0), ("east", 1.0)):
        good = frame(BARE, source, hours)
        # An image that says sky everywhere contradicts the terrain; only the skyline itself may be doubted.
        surface.add(replace(good, depth=depth, measured=np.full(depth.shape, np.isfinite(value))))
    assert len(surface.decide().rows) == 0


def test_a_pose_that_is_off_is_turned_back() -> None:
    rules = RULES.model_copy(update={"register_frames": True})
    surface = surface_map(BARE.copy(), rules)
    good = frame(BARE)
    azimuth, pitch, roll = good.pose.angles_deg
    wrong = Pose.from_angles(good.pose.position, azimuth + 0.4, pitch - 0.5, roll + 0.3)
    known_to = np.diag([1e-6] * 3 + [np.radians(0.5) ** 2] * 3)
    added = surface.add(replace(good, pose=wrong, covariance=known_to))
    turned = added.registration
    assert turned is not None
    off = turned.pose.rotation.T @ good.pose.rotation
    left = np.degrees(np.arccos((np.trace(off) - 1) / 2))
    # Of 0.71 degrees; roll, which shows least on one slope, keeps most of what is left.
    assert left < 0.3 < 0.5 < turned.turned_deg
    assert turned.residual[1] < 0.2 * turned.residual[0]
    again = surface.add(replace(frame(BARE, hours=0.1), pose=wrong, covariance=known_to))
    assert again.registration is turned, "a camera that stands still is registered once"


def test_state_outlives_the_process(tmp_path: Path) -> None:
    path = tmp_path / "terrain.sqlite"
    schema = schema_of(GEOMETRY)
    with TileStore.open(path, schema) as store:
        surface = surface_map(BARE.copy(), store=store)
        surface.add(frame(RAISED, "west"))
        assert surface.commit() > 0
        assert surface.uncommitted == 0
    with TileStore.open(path, schema) as store:
        surface = surface_map(BARE.copy(), store=store)
        assert surface.counted("west", BEGIN)
        assert not surface.counted("east", BEGIN)
        surface.add(frame(RAISED, "east", 0.5))
        surface.decide()
        assert changed_share(surface) > 0.9
        surface.commit()
        journal = list(store.changes("change"))
        assert sum(len(change.rows) for change in journal) == int((surface.layers().change > 0).sum())


def test_memory_is_bounded_and_nothing_is_lost_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tiles of two views do not fit together: those of one go to the store and come back."""
    monkeypatch.setattr("ltm_core.surface.surface_map.DECIDED_TILES", 3)
    large = surface_map(BARE.copy())
    monkeypatch.setattr(TilePool, "capacity_of", lambda megabytes: 11)
    small = surface_map(BARE.copy())
    for one in [frame(RAISED, source, hours) for hours in (0.0, 1.5) for source in PLACES]:
        large.add(one)
        assert small.add(one).left_out == 0
        assert small.tiles_in_memory <= 11 < large.tiles_in_memory or one.source == "west"
    large.decide(), small.decide()
    assert (large.layers().change > 0).sum() > 300
    for name in ("change", "height", "sigma", "frames"):
        np.testing.assert_array_equal(getattr(large.layers(), name), getattr(small.layers(), name), err_msg=name)


def test_bad_frames_are_named() -> None:
    surface = surface_map()
    good = frame(BARE)
    with pytest.raises(ConfigError, match=r"no camera 'north'; .*west, east"):
        surface.add(replace(good, source="north"))
    with pytest.raises(ImageError, match=r"sigma image of \(7, 5\)"):
        replace(good, sigma=np.ones((7, 5), np.float32))
    with pytest.raises(PoseError, match="negative variances"):
        replace(good, covariance=-np.eye(6))
    under = Pose(good.pose.position - np.array([0.0, 0.0, 60.0]), good.pose.rotation)
    with pytest.raises(PoseError, match="under the ground"):
        surface.add(replace(good, pose=under))
    with pytest.raises(ConfigError, match="32 cameras"):
        SurfaceMap(surface.reference, RULES, [f"c{i}" for i in range(33)])
