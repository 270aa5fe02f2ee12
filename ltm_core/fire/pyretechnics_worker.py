"""Compute fires with Pyretechnics. This program runs in its own interpreter and does not import the project.

Pyretechnics pins a NumPy that excludes ours, so `ltm_core.fire.pyretechnics` starts this file with the Python of
another environment. Its argument is JSON; it writes a file, and prints the version of the model."""

import json
import sys
from importlib.metadata import version
from typing import Any

import numpy as np
from pyretechnics.eulerian_level_set import SpreadState, spread_fire_with_phi_field
from pyretechnics.fuel_models import fuel_model_exists
from pyretechnics.space_time_cube import SpaceTimeCube

BARE = 99
WOODY_13 = (4, 5, 7, 10)
"""Anderson's fuel models with woody live fuel, which the table of Pyretechnics treats as herbaceous (BehavePlus:
woody)."""


def cubes(bands: Any, weather: dict[str, float], shape: tuple[int, int, int]) -> dict[str, Any]:
    """Return space-time cubes of a landscape's bands (7, H, W), slope to bulk density, in LANDFIRE's units, nodata
    -9999. Rows of Pyretechnics go from south to north."""
    slope, aspect, fuel, cover, height, base, density = bands[:, ::-1].astype(np.float32)
    known = fuel != -9999
    codes = np.unique(fuel).astype(int)
    modelled = np.isin(fuel, [code for code in codes.tolist() if fuel_model_exists(code)])
    layers = {
        "slope": np.tan(np.radians(np.where(slope < 0, 0, slope))),
        "aspect": np.where(aspect < 0, 0, aspect),
        "fuel_model": np.where(known & modelled, fuel, BARE),
        "canopy_cover": np.where(cover < 0, 0, cover) / 100,
        "canopy_height": np.where(height < 0, 0, height) / 10,
        "canopy_base_height": np.where(base < 0, 0, base) / 10,
        "canopy_bulk_density": np.where(density < 0, 0, density) / 100,
    }
    result = {name: SpaceTimeCube(shape, np.ascontiguousarray(v, dtype=np.float32)) for name, v in layers.items()}
    result.update({name: SpaceTimeCube(shape, value) for name, value in weather.items()})
    herbs, wood = weather["fuel_moisture_live_herbaceous"], weather["fuel_moisture_live_woody"]
    live = np.where(np.isin(layers["fuel_model"], WOODY_13), wood, herbs)
    result["fuel_moisture_live_herbaceous"] = SpaceTimeCube(shape, np.ascontiguousarray(live, dtype=np.float32))
    return result


def weather_of(asked: dict[str, Any]) -> dict[str, float]:
    """Return the weather with Pyretechnics' names: km/h, degrees, shares."""
    moisture = asked["moisture"]
    return {
        "wind_speed_10m": asked["wind_speed"] * 3.6,
        "upwind_direction": asked["wind_from"],
        "fuel_moisture_dead_1hr": moisture[0] / 100,
        "fuel_moisture_dead_10hr": moisture[1] / 100,
        "fuel_moisture_dead_100hr": moisture[2] / 100,
        "fuel_moisture_live_herbaceous": moisture[3] / 100,
        "fuel_moisture_live_woody": moisture[4] / 100,
        "foliar_moisture": moisture[5] / 100,
    }


def spread(asked: dict[str, Any]) -> None:
    """Write arrival (H, W) in minutes, NaN where it does not burn, and flame length (H, W) in metres."""
    with np.load(asked["given"]) as given:
        bands = given["bands"]
    rows, cols = bands.shape[1:]
    minutes = asked["minutes"]
    shape = (int(np.ceil(minutes / 60)), rows, cols)
    state = SpreadState(shape).ignite_cell((rows - 1 - asked["row"], asked["col"]))
    result = spread_fire_with_phi_field(
        cubes(bands, weather_of(asked), shape), state, (60.0, asked["cell"], asked["cell"]), 0.0, minutes
    )
    found = result["spread_state"].get_full_matrices()
    burned = found["fire_type"] > 0
    arrival = np.where(burned, found["time_of_arrival"], np.nan)[::-1].astype(np.float32)
    flame = np.where(burned, found["flame_length"], 0.0)[::-1].astype(np.float32)
    arrival[asked["row"], asked["col"]] = 0.0
    np.savez(asked["result"], arrival=arrival, flame=flame)


if __name__ == "__main__":
    spread(json.loads(sys.argv[1]))
    print(version("pyretechnics"))
