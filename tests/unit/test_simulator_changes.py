"""Changes between the dates of a simulated site: masks, stands, ground, true rasters, sensors, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ltm_core.errors import ConfigError, RasterError
from ltm_core.grid import GridGeometry
from ltm_core.pose import Pose
from ltm_core.simulator.camera_setup import PHONE, SensorConfig
from ltm_core.simulator.changes import (
    Burn,
    Change,
    Conversion,
    Cut,
    Density,
    Growth,
    Landslide,
    MaskConfig,
    Thinning,
)
from ltm_core.simulator.ground_io import read_codes, read_elevation
from ltm_core.simulator.landcover import BARE, GRASS, SHRUB, TREE, LandCover, Stand
from ltm_core.simulator.rasters import (
    CANOPY_CHANGED,
    CLASS_CHANGED,
    TERRAIN_CHANGED,
    SiteRasters,
    fuel_codes,
    site_change,
)
from ltm_core.simulator.scenario import LakeConfig
from ltm_core.simulator.scenario_io import load_scenario
from ltm_core.simulator.sensors import SensorModel
from ltm_core.simulator.stand import changed_terrain, mask_weights, stand_at
from ltm_core.simulator.terrain import HeightField, Terrain
from ltm_core.simulator.works import with_lakes

GRID = GridGeometry(0.0, 300.0, 4.0, 100, 75)  # 400 m by 300 m
BOX = MaskConfig(box=(100.0, 60.0, 240.0, 180.0), ragged=0.0)


def cover(classes: NDArray[np.uint8] | int = SHRUB) -> LandCover:
    zeros = np.zeros(GRID.shape, np.float32)
    values = np.broadcast_to(np.asarray(classes, np.uint8), GRID.shape).copy()
    return LandCover(values, zeros.astype(bool), zeros, zeros, GRID, Stand.undisturbed(GRID.shape))


def inside_box() -> NDArray[np.bool_]:
    x, y = GRID.to_map(*np.mgrid[0 : GRID.height, 0 : GRID.width])
    return np.asarray((x >= 100) & (x <= 240) & (y >= 60) & (y <= 180), np.bool_)


def after(change: Change, years: float, classes: NDArray[np.uint8] | int = SHRUB) -> LandCover:
    return stand_at(cover(classes), [change], years, 25.0, False, 3)


def test_shapes_of_masks() -> None:
    np.testing.assert_array_equal(mask_weights(BOX, GRID, 1), inside_box())
    corners = [(100.0, 60.0), (240.0, 60.0), (240.0, 180.0), (100.0, 180.0)]
    np.testing.assert_array_equal(mask_weights(MaskConfig(polygon=corners, ragged=0), GRID, 1), inside_box())
    round_one = mask_weights(MaskConfig(circle=(200.0, 150.0, 60.0), ragged=0), GRID, 1)
    assert round_one.sum() * 16 == pytest.approx(np.pi * 60**2, rel=0.02)
    ragged = mask_weights(MaskConfig(circle=(200.0, 150.0, 60.0), ragged=12), GRID, 1)
    assert ragged.sum() == pytest.approx(round_one.sum(), rel=0.3)
    assert np.any(ragged != round_one)


def test_dates_before_a_change_do_not_see_it() -> None:
    change = Conversion(kind="conversion", to="conifer", mask=BOX, years=2.0)
    assert np.all(after(change, 1.9).classes == SHRUB)
    converted = after(change, 2.0)
    np.testing.assert_array_equal(converted.classes == TREE, inside_box())
    np.testing.assert_array_equal(converted.stand.conifer, inside_box())
    np.testing.assert_array_equal(
        converted.stand.tree_height[~inside_box()], after(change, 0.0).stand.tree_height[0, 0]
    )


def test_conversion_takes_the_classes_named() -> None:
    stripes = np.where(np.arange(GRID.width) % 2, GRASS, TREE).astype(np.uint8)[None, :]
    change = Conversion(kind="conversion", to="shrub", of=["grass"], mask=BOX, age=4.0)
    out = after(change, 0.0, stripes)
    assert np.all(out.classes[:, ::2] == TREE)
    np.testing.assert_array_equal(out.classes[:, 1::2] == SHRUB, inside_box()[:, 1::2])
    young = out.stand.shrub_height[:, 1::2][inside_box()[:, 1::2]]
    assert np.all(young < 0.5)


def test_plants_grow_with_the_years_and_grown_ones_hardly() -> None:
    change = Growth(kind="growth", by=30.0, mask=BOX)
    young = stand_at(cover(), [], 0.0, 3.0, True, 3).stand.shrub_height
    later = stand_at(cover(), [], 10.0, 3.0, True, 3).stand.shrub_height
    still = stand_at(cover(), [], 10.0, 3.0, False, 3).stand.shrub_height
    assert young[0, 0] < 0.4 < later[0, 0] < 1.0
    np.testing.assert_array_equal(still, young)
    grown = stand_at(cover(), [change], 0.0, 3.0, False, 3).stand.shrub_height
    assert np.all(grown[inside_box()] > 1.0)
    np.testing.assert_array_equal(grown[~inside_box()], young[~inside_box()])


def test_thinning_leaves_the_share_and_felling_opens_the_land() -> None:
    thinned = after(Thinning(kind="thinning", keep=0.4, mask=BOX), 0.0, TREE)
    np.testing.assert_allclose(thinned.stand.density, np.where(inside_box(), 0.4, 1.0), rtol=1e-6)
    assert np.all(thinned.classes == TREE)
    felled = after(Thinning(kind="thinning", keep=0.0, mask=BOX), 0.0, TREE)
    np.testing.assert_array_equal(felled.classes == GRASS, inside_box())
    shrub = after(Density(kind="density", factor=0.5, mask=BOX), 0.0)
    np.testing.assert_allclose(shrub.stand.density, np.where(inside_box(), 0.5, 1.0))


def test_a_wildfire_blackens_then_heals() -> None:
    fire = Burn(kind="burn", severity=1.0, mask=BOX, years=1.0)
    fresh, herbs, shrubs = (after(fire, y) for y in (1.0, 2.0, 6.0))
    burnt = (fresh.classes == BARE) & inside_box()
    assert burnt.sum() > 0.9 * inside_box().sum()
    assert np.all(fresh.classes[~inside_box()] == SHRUB)
    assert np.all(fresh.stand.dead[burnt] == SHRUB)
    assert fresh.stand.char[burnt].mean() > 0.8 > 0.4 > herbs.stand.char[burnt].mean()
    assert np.all(herbs.classes[burnt] == GRASS)
    assert np.all(shrubs.classes[burnt] == SHRUB)
    assert np.all(shrubs.stand.shrub_height[burnt] < 0.6)


def test_changes_that_end_in_an_edge_say_where() -> None:
    """There shrubs are planted one by one: a whole patch of them would draw the edge straight."""
    fire = after(Burn(kind="burn", severity=1.0, mask=BOX), 0.0)
    np.testing.assert_array_equal(fire.stand.touched > 0, fire.classes == BARE)
    thinned = after(Thinning(kind="thinning", keep=0.4, of=["tree"], mask=BOX), 0.0)
    assert not thinned.stand.touched.any(), "there were no trees"
    planted = after(Conversion(kind="conversion", to="conifer", mask=BOX), 0.0)
    assert not planted.stand.touched.any(), "trees stand singly anyway"
    slide = after(Landslide(kind="landslide", mask=BOX), 0.0)
    np.testing.assert_array_equal(slide.stand.rubble, inside_box())
    np.testing.assert_array_equal(slide.stand.touched > 0, inside_box())
    assert not after(Cut(kind="cut", depth=2.0, mask=BOX), 0.0).stand.rubble.any()


def test_trees_die_by_severity_and_a_prescribed_burn_spares_them() -> None:
    wild = after(Burn(kind="burn", severity=1.0, mask=BOX), 0.0, TREE)
    light = after(Burn(kind="burn", severity=0.35, mask=BOX), 0.0, TREE)
    planned = after(Burn(kind="burn", severity=0.5, prescribed=True, mask=BOX), 0.0, TREE)
    killed = [np.mean(c.stand.dead[inside_box()] == TREE) for c in (wild, light, planned)]
    assert killed[0] > 0.6 > 0.1 > killed[1]
    assert killed[2] == 0
    assert np.all(planned.classes == TREE)
    assert 0.2 < np.mean(planned.stand.char[inside_box()] > 0.2) < 0.98, "it leaves patches"
    assert light.stand.scorch.max() > planned.stand.scorch.max() > 0


def terrain() -> Terrain:
    fields = []
    for g in (GridGeometry(0.0, 300.0, 2.0, 150, 150), GridGeometry(-104.0, 404.0, 8.0, 64, 64)):
        x, y = np.meshgrid(*HeightField(np.empty((0, 0), np.float32), g).axes())
        fields.append(HeightField((200 + 0.3 * x + 0.05 * np.abs(y - 150)).astype(np.float32), g))
    return Terrain(fields[0], fields[1], np.zeros((64, 64), np.float32))


def test_earth_moves_inside_the_mask_and_stays() -> None:
    ground = terrain()
    mask = MaskConfig(box=(60.0, 80.0, 220.0, 200.0), ragged=0.0)
    slide = Landslide(kind="landslide", depth=6.0, deposit=1.0, mask=mask, years=1.0)
    assert changed_terrain(ground, [slide], 0.5, 3) is ground
    moved = changed_terrain(ground, [slide], 1.0, 3)
    dz = moved.site.elevation - ground.site.elevation
    x, _ = np.meshgrid(*moved.site.axes())
    assert dz.min() == pytest.approx(-6.0, abs=0.3)
    assert dz[x < 120].max() > 2.0
    assert dz[:, x[0] > 190].max() < 0.05, "it slides downhill"
    assert abs(dz.sum()) < 0.1 * np.abs(dz).sum(), "what leaves the scar lies in the toe"
    wide_dz = moved.surroundings.at(180.0, 140.0) - ground.surroundings.at(180.0, 140.0)
    assert wide_dz == pytest.approx(float(moved.site.at(180.0, 140.0) - ground.site.at(180.0, 140.0)), abs=0.8)


def test_a_cut_has_its_depth_and_ramps() -> None:
    ground = terrain()
    mask = MaskConfig(box=(60.0, 80.0, 220.0, 200.0), ragged=0.0)
    dug = changed_terrain(ground, [Cut(kind="cut", depth=4.0, ramp=10.0, mask=mask)], 0.0, 3)
    dz = dug.site.elevation - ground.site.elevation
    x, y = np.meshgrid(*dug.site.axes())
    deep = (x > 75) & (x < 205) & (y > 95) & (y < 185)
    np.testing.assert_allclose(dz[deep], -4.0, atol=0.01)
    outside = (x < 60) | (x > 220) | (y < 80) | (y > 200)
    assert np.all(dz[outside] == 0)
    assert -2.5 < dz[np.argmin(np.abs(y[:, 0] - 140)), np.argmin(np.abs(x[0] - 64.5))] < -0.5


def test_a_reservoir_is_level_and_dammed() -> None:
    ground = terrain()
    lake = LakeConfig(x=150.0, y=150.0, depth=8.0, radius=60.0)
    filled, (water,) = with_lakes(ground, [lake])
    level = float(filled.surroundings.elevation[water].max())
    np.testing.assert_array_equal(filled.surroundings.elevation[water], np.float32(level))
    x, y = np.meshgrid(*filled.site.axes())
    reach = np.hypot(x - 150, y - 150)
    flooded = (filled.site.elevation == np.float32(level)) & (reach < 60)
    assert flooded.sum() * 4 > 2000
    dam = (reach > 60) & (reach < 68) & (x < 110)
    assert np.all(filled.site.elevation[dam] >= level)
    far = (reach > 110) & (x > 170)  # away from the dam
    np.testing.assert_array_equal(filled.site.elevation[far], ground.site.elevation[far])
    assert with_lakes(ground, [])[0] is ground
    with pytest.raises(ConfigError, match=r"lakes\.0.*outside"):
        with_lakes(ground, [LakeConfig(x=9000.0, y=0.0)])


def test_fuel_codes_follow_cover_moisture_and_height() -> None:
    classes = np.full(GRID.shape, GRASS, np.uint8)
    classes[:, 25:50], classes[:, 50:75], classes[:, 75:] = SHRUB, TREE, BARE
    low = after(Growth(kind="growth", by=1e-3, mask=BOX), 0.0, classes)
    tall = stand_at(cover(classes), [], 0.0, 1.0, False, 3)
    cells = GridGeometry(0.0, 300.0, 100.0, 4, 3)
    forms = np.tile(np.array([GRASS, SHRUB, TREE, BARE], np.uint8), (3, 1))
    codes = fuel_codes(forms, low, cells, (0.0, 0.0))
    assert codes.tolist() == [[102, 147, 186, 99]] * 3
    assert fuel_codes(forms, tall, cells, (0.0, 0.0))[0].tolist() == [102, 142, 186, 99], "young shrub is low"


def test_change_bits() -> None:
    g = GridGeometry(0.0, 3.0, 1.0, 4, 3)
    coarse = GridGeometry(0.0, 30.0, 30.0, 1, 1)

    def rasters(ground: float, plants: float, class_id: int, code: int) -> SiteRasters:
        flat = np.full(g.shape, 100.0, np.float32)
        bare, canopy, classes = flat.copy(), 0 * flat, np.full(g.shape, GRASS, np.uint8)
        bare[0, 1] += ground
        canopy[1, 2] += plants
        classes[2, 3] = class_id
        form = np.full((1, 1), GRASS, np.uint8)
        return SiteRasters(bare, canopy, classes, g, form, np.full((1, 1), code, np.uint8), coarse)

    change = site_change(rasters(0, 0, GRASS, 102), rasters(0.2, 0.6, SHRUB, 122))
    want = np.zeros(g.shape, np.uint8)
    want[0, 1], want[1, 2], want[2, 3] = TERRAIN_CHANGED, CANOPY_CHANGED, CLASS_CHANGED
    np.testing.assert_array_equal(change.fine, want)
    assert not change.life_form[0, 0]
    assert change.fuel_code[0, 0]
    small = site_change(rasters(0, 0, GRASS, 102), rasters(0.05, 0.4, GRASS, 102))
    assert not small.fine.any()


def test_a_phone_errs_as_it_says() -> None:
    pose = Pose.from_angles((10.0, 20.0, 300.0), 200.0, -5.0, 1.0)
    errors = []
    for k in range(300):
        report = SensorModel(PHONE.model_copy(update={"lost": 0.0}), f"phone{k}", 5).report(pose, 1_000_000_000_000)
        assert report is not None
        azimuth, pitch, _ = report.pose.angles_deg
        errors.append([*(report.pose.position - pose.position), (azimuth - 200 + 180) % 360 - 180, pitch + 5.0])
        assert report.stamp_ns == 1_000_250_000_000
        assert report.received_ns >= 1_000_000_000_000
        covariance = report.covariance
    spread = np.std(errors, axis=0)
    np.testing.assert_allclose(spread, np.array([5.1, 5.1, 4.03, 6.18, 0.7]), rtol=0.15)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance))[:3], np.array([5.1, 5.1, 4.03]), rtol=0.01)


def test_constant_errors_stay_and_frames_get_lost_or_late() -> None:
    pose = Pose.from_angles((10.0, 20.0, 300.0), 200.0, -5.0)
    model = SensorModel(SensorConfig(compass_bias_deg=5.0, lost=0.3, late=0.5, late_s=2.0), "a", 1)
    reports = [model.report(pose, 10**12) for _ in range(400)]
    arrived = [r for r in reports if r is not None]
    assert len(arrived) == pytest.approx(280, abs=30)
    assert len({round(r.pose.angles_deg[0], 6) for r in arrived}) == 1
    delays = np.array([r.received_ns - 10**12 for r in arrived]) / 1e9
    assert 0.4 < np.mean(delays > 0) < 0.6
    assert delays.max() <= 2.0
    exact = SensorModel(SensorConfig(), "a", 1).report(pose, 10**12)
    assert exact is not None
    np.testing.assert_allclose(exact.pose.rotation, pose.rotation, atol=1e-12)
    assert not exact.covariance.any()


BAD = """name: bad
seed: 1
terrain:
  size: 1000
changes:
  - kind: burn
    mask: {circle: [500, 500, 100]}
cameras:
  - {name: tower, x: 100, y: 120, patrol: {azimuth_deg: [10]}}
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("[500, 500, 100]", "[950, 500, 100]", 6, "outside the site"),
        ("kind: burn", "kind: blaze", 6, "burn"),
        ("kind: burn", "kind: conversion\n    to: redwood", 7, "conifer"),
        ("size: 1000", "size: 1000\n  relif: 3", 5, "unknown key"),
        ("x: 100", "x: 1200", 9, "outside the site"),
        ("{circle: [500, 500, 100]}", "{ragged: 3}", 7, "give one of polygon, circle, box"),
        ("seed: 1", "seed: 1\ndates: [{name: b, years: 3}, {name: a}]", 1, "in order of years"),
        (
            "seed: 1",
            "seed: 1\ndates: [{name: a}, {name: b, years: 15}]",
            3,
            r"dates\.1 \(b\): 15 years .*past 19 .*2038",
        ),
        ("seed: 1", "seed: 1\ncrs: EPSG:4326", 3, "WGS 84, which is not in metres; give a projected CRS"),
        ("seed: 1", "seed: 1\ncrs: EPSG:2230", 3, "not in metres"),
        ("seed: 1", "seed: 1\ncrs: UTM eleven", 3, "no CRS that PROJ knows; give one such as EPSG:32611"),
        ("seed: 1", "seed: 1\nsmoke: [{x: 40, y: 1040}]", 3, r"smoke\.0: the column at \(40, 1040\) is outside"),
        ("seed: 1", "seed: 1\ndates: [{name: a, smoke: [{x: -2, y: 4}]}]", 3, r"dates\.0: smoke .*outside the site"),
        ("size: 1000", "size: 1000\n  surroundings: 800", 5, "narrower than the site of 1000 m; give at least 1000"),
        (
            "kind: burn",
            "kind: burn\n    years: 2.5",
            6,
            r"after the last date \(now, year 0\); give a date that sees it",
        ),
        ("seed: 1", "seed: 1\nclouds: {cover: 1.2}", 3, "clouds.cover: .*less than or equal to 1"),
        ("seed: 1", "seed: 1\nclouds: {kind: nimbus}", 3, "'cumulus' or 'stratus'.*nimbus"),
        ("x: 100, y", "x: 100, sensor: {lost: 1.5}, y", 9, "lost: .*less than 1"),
    ],
)
def test_bad_scenarios_are_refused_with_their_line(tmp_path: Path, old: str, new: str, line: int, says: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(BAD.replace(old, new))
    with pytest.raises(ConfigError, match=says) as caught:
        load_scenario(path)
    assert f"bad.yaml:{line}:" in str(caught.value)


def test_paths_are_relative_to_the_scenario(tmp_path: Path) -> None:
    path = tmp_path / "real.yaml"
    path.write_text(BAD.replace("size: 1000", "size: 1000\n  dem: ground/dem.tif"))
    assert load_scenario(path).terrain.dem == tmp_path / "ground/dem.tif"


def test_real_ground_is_resampled_into_the_site(tmp_path: Path) -> None:
    import rasterio
    from rasterio.transform import from_origin

    x, y = np.meshgrid(500_000 + 30 * (np.arange(40) + 0.5), 3_700_900 - 30 * (np.arange(30) + 0.5))
    plane = (0.1 * (x - 500_000) - 0.2 * (y - 3_700_000) + 700).astype(np.float32)
    profile = {
        "driver": "GTiff",
        "width": 40,
        "height": 30,
        "count": 1,
        "transform": from_origin(500_000, 3_700_900, 30, 30),
    }
    for name, array, crs in (
        ("dem", plane, "EPSG:32611"),
        ("codes", (plane > 700).astype(np.int16) + 101, "EPSG:32611"),
        ("bare", plane, None),
    ):
        with rasterio.open(tmp_path / f"{name}.tif", "w", dtype=array.dtype, crs=crs, **profile) as sink:
            sink.write(array, 1)
    grid = GridGeometry(500_100.0, 3_700_700.0, 8.0, 50, 60, "EPSG:32611")
    gx, gy = grid.to_map(*np.mgrid[0:60, 0:50])
    want = 0.1 * (gx - 500_000) - 0.2 * (gy - 3_700_000) + 700
    np.testing.assert_allclose(read_elevation(tmp_path / "dem.tif", grid), want, atol=0.01)
    assert set(np.unique(read_codes(tmp_path / "codes.tif", grid))) <= {101, 102}
    with pytest.raises(RasterError, match=r"has no CRS.*a_srs"):
        read_elevation(tmp_path / "bare.tif", grid)
    with pytest.raises(RasterError, match=r"no elevation in .*origin"):
        read_elevation(tmp_path / "dem.tif", grid.translated(3000.0, 0.0, "EPSG:32611"))
    with pytest.raises(RasterError, match="cannot be read"):
        read_elevation(tmp_path / "none.tif", grid)
