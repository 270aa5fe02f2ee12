"""Burns a GeoTIFF landscape with Pyretechnics, in whatever interpreter has it: LANDSCAPE ROW COL -> JSON."""

import json
import sys

import numpy as np
import rasterio
from pyretechnics.eulerian_level_set import SpreadState, spread_fire_with_phi_field
from pyretechnics.space_time_cube import SpaceTimeCube

path, row, col = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
with rasterio.open(path) as source:
    _, slope, aspect, fuel, cover, height, base, density = source.read().astype(np.float32)
    cell = source.transform.a
shape = (24, *fuel.shape)
layers = {
    "slope": np.tan(np.radians(slope)),
    "aspect": np.where(aspect < 0, 0, aspect),
    "fuel_model": fuel,
    "canopy_cover": cover / 100,
    "canopy_height": height / 10,
    "canopy_base_height": base / 10,
    "canopy_bulk_density": density / 100,
    "wind_speed_10m": 10.0,
    "upwind_direction": 270.0,
    "fuel_moisture_dead_1hr": 0.06,
    "fuel_moisture_dead_10hr": 0.07,
    "fuel_moisture_dead_100hr": 0.08,
    "fuel_moisture_live_herbaceous": 0.6,
    "fuel_moisture_live_woody": 0.9,
    "foliar_moisture": 0.9,
}
cubes = {name: SpaceTimeCube(shape, np.float32(v) if np.ndim(v) else v) for name, v in layers.items()}
state = SpreadState(shape).ignite_cell((row, col))
result = spread_fire_with_phi_field(cubes, state, (60.0, cell, cell), 0.0, 240.0)
matrices = result["spread_state"].get_full_matrices()
burned = matrices["fire_type"] > 0
rate = matrices["spread_rate"]
print(
    json.dumps(
        {
            int(code): {
                "cells": int((fuel == code).sum()),
                "burned": int((burned & (fuel == code)).sum()),
                "rate": float(np.median(rate[burned & (fuel == code)])) if (burned & (fuel == code)).any() else 0.0,
            }
            for code in np.unique(fuel)
        }
    )
)
