from dataclasses import replace

import numpy as np
import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.codes import FUEL_TYPES, FuelClimate, FuelSystem, fuel_models, of_one_fuel_type
from ltm_core.fuel.decision import layers_of_classes
from ltm_core.fuel.export.landscape import surface_codes
from ltm_core.fuel.life_form import NODATA, NONBURNABLE, LifeForm
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.grid import GridGeometry

CLIMATES = ("dry", "humid")
F13, F40 = FuelSystem.FBFM13, FuelSystem.FBFM40


def partners(code: int) -> range:
    return next((models for codes, models in FUEL_TYPES.items() if code in codes), range(0))


def prior_of(codes: list[list[int]], **more: object) -> FuelPrior:
    array = np.array(codes, np.int16)
    grid = GridGeometry(0.0, 90.0, 30.0, array.shape[1], array.shape[0], "EPSG:32611")
    return FuelPrior(array, grid, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("climate", CLIMATES)
@pytest.mark.parametrize("cover", [None, 0, 35, 85])
def test_every_code_stays_in_its_fuel_type(climate: str, cover: int | None) -> None:
    codes = np.array([[*fuel_models().fbfm40, *NONBURNABLE, 14, 55, 89, 0, 256, -5, NODATA]], np.int16)
    trees = None if cover is None else np.full(codes.shape, cover, np.int16)
    found = FuelClimate.named(climate).crossed(codes, F13, trees)[0]
    for code, to in zip(codes[0].tolist(), found.tolist(), strict=True):
        if code in fuel_models().fbfm40:
            assert to in partners(code), (code, to)
        else:
            assert to == (code if code in (*NONBURNABLE, 14, 55, 89) else NODATA)


def test_grass_under_open_trees_is_timber_with_grass() -> None:
    codes, cover = np.array([[102, 102, 102, 102]], np.int16), np.array([[0, 9, 10, NODATA]], np.int16)
    found = FuelClimate.named("dry").crossed(codes, F13, cover)
    np.testing.assert_array_equal(found, [[1, 1, 2, 1]])


def test_fuel_types_of_two_maps() -> None:
    fbfm40 = np.array([[102, 102, 122, 122, 145], [91, 91, 20, NODATA, 183]], np.int16)
    fbfm13 = np.array([[3, 5, 2, 8, 4], [98, 5, 7, 5, NODATA]], np.int16)
    wanted = [[True, False, True, False, True], [True, False, True, True, True]]
    np.testing.assert_array_equal(of_one_fuel_type(fbfm40, fbfm13), wanted)


@pytest.mark.parametrize("climate", CLIMATES)
def test_changed_cells_take_the_climates_codes_in_both_systems(climate: str) -> None:
    changed = FuelClimate.named(climate).changed
    forms = [LifeForm.GRASS, LifeForm.SHRUB, LifeForm.TREE, LifeForm.BARE, LifeForm.WATER, LifeForm.BUILT]
    keys = ["grass", "shrub", "to_tree", "bare", "water", "built"]
    prior = prior_of([[183, 183, 102, 102, 102, 102], [183, 102, 145, 183, 183, 102]])
    seen = np.array([forms, [LifeForm.TREE, LifeForm.GRASS, 255, 255, 255, LifeForm.TREE]], np.uint8)
    seen[1, 5] = 255
    layers = layers_of_classes(seen, prior, FuelClimate.named(climate))
    assert layers.changed.sum() == 6
    for system in (F40, F13):
        found = surface_codes(layers, prior, FuelClimate.named(climate), system)
        assert found[0].tolist() == [getattr(changed[system], key) for key in keys]
    # The map's own FBFM13 holds where nothing has changed, and only there.
    own = np.full(prior.codes.shape, 7, np.int16)
    found = surface_codes(layers, replace(prior, fbfm13=own), FuelClimate.named(climate), F13)
    assert found[0].tolist() == [getattr(changed[F13], key) for key in keys]
    assert (found[1] == 7).all()


@pytest.mark.parametrize("climate", CLIMATES)
def test_a_prior_of_fbfm13_becomes_fbfm40(climate: str) -> None:
    prior = prior_of([[*range(1, 14), 91, 98, 20, NODATA]], system=F13)
    layers = layers_of_classes(np.full(prior.codes.shape, 255, np.uint8), prior, FuelClimate.named(climate))
    found = surface_codes(layers, prior, FuelClimate.named(climate), F40)[0].tolist()
    assert all(code in partners(to) for code, to in zip(range(1, 14), found[:13], strict=True))
    assert found[13:] == [91, 98, 20, NODATA]


def test_codes_of_no_system_that_a_site_keeps_pass_into_the_other_system() -> None:
    """The 256 by which ELMFIRE marks buildings; a map of the other system that has a code there goes before."""
    climate = FuelClimate.named("dry")
    prior = prior_of([[256, 102, 256, NODATA], [183, 256, 101, 102]])
    seen = np.full((2, 4), 255, np.uint8)
    seen[0, 2] = LifeForm.SHRUB
    layers = layers_of_classes(seen, prior, climate)
    found = surface_codes(layers, prior, climate, F13)
    assert (found[0, 0], found[1, 1], found[0, 3]) == (256, 256, NODATA)
    assert 256 not in found[[0, 1], [1, 2]]
    own = np.full(prior.codes.shape, NODATA, np.int16)
    own[0, 0] = 91
    found = surface_codes(layers, replace(prior, fbfm13=own), climate, F13)
    assert (found[0, 0], found[1, 1]) == (91, 256)
    back = prior_of([[256, 4]], system=F13)
    kept = layers_of_classes(np.full((1, 2), 255, np.uint8), back, climate)
    assert surface_codes(kept, back, climate, F40)[0, 0] == 256


@pytest.mark.parametrize("own", [14, 37, 89])
def test_no_label_changes_an_analysts_own_model(own: int) -> None:
    prior = prior_of([[own, 102, own], [own, 102, 98]])
    climate = FuelClimate.named("dry")
    layers = layers_of_classes(np.full((2, 3), LifeForm.TREE, np.uint8), prior, climate)
    np.testing.assert_array_equal(layers.code, [[own, 183, own], [own, 183, 98]])
    np.testing.assert_array_equal(layers.changed, [[False, True, False]] * 2)
    np.testing.assert_array_equal(surface_codes(layers, prior, climate, F13), [[own, 8, own], [own, 8, 98]])


@pytest.mark.parametrize("climate", CLIMATES)
def test_the_tables_of_a_climate_name_each_code_once_and_mix_no_fuel_types(climate: str) -> None:
    found, models = FuelClimate.named(climate), fuel_models()
    assert found.crosswalk.keys() == models.fbfm40.keys()
    assert found.crosswalk_back.keys() == models.fbfm13.keys()
    pairs = [*found.crosswalk.items(), *((code, to) for code, (_, to) in found.under_trees.items())]
    assert all(to in partners(code) for code, to in pairs)
    assert all(code in partners(to) for code, to in found.crosswalk_back.items())
    codes = found.changed[F40].model_dump(), found.changed[F13].model_dump()
    assert set(codes[0].values()) <= models.codes(F40)
    assert all(codes[1][key] in (partners(code) or (code,)) for key, code in codes[0].items())


def test_an_unknown_climate() -> None:
    with pytest.raises(ConfigError, match="dry, humid"):
        FuelClimate.named("arctic")
