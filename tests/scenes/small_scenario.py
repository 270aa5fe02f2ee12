"""A scenario small enough for tests of the simulator: a slide, a burn, a lake and houses, seen by two cameras."""

from typing import Any

from ltm_lab.simulator.scenario import Scenario

CAMERA = {"name": "a", "x": 120.0, "y": 90.0, "mast": 25.0, "patrol": {"azimuth_deg": [40.0], "pitch_deg": [-14.0]}}


def small_scenario(**changes: Any) -> Scenario:
    """The scenario with `changes` in place of its own values."""
    values: dict[str, Any] = {
        "name": "small",
        "seed": 17,
        "image": {"width": 120, "height": 80},
        "truth_step": 1,
        "imaging": {"samples": 1},
        "terrain": {"size": 400.0, "surroundings": 1024.0, "relief": 110.0, "resolution": 2.0},
        "vegetation": {"detail_radius": 200.0, "grass_radius": 20.0, "houses": 8, "tree": 0.3},
        "lakes": [{"x": 210.0, "y": 190.0, "depth": 2.0, "radius": 40.0}],
        "dates": [{"name": "before"}, {"name": "after", "years": 1.0}],
        "changes": [
            {"kind": "landslide", "depth": 5.0, "mask": {"circle": [120, 260, 50]}, "years": 1.0},
            {"kind": "burn", "mask": {"box": [220, 220, 380, 380]}, "years": 1.0},
        ],
        "cameras": [
            CAMERA,
            {"name": "b", "x": 180.0, "y": 90.0, "mast": 90.0, "patrol": {"azimuth_deg": [17.0], "pitch_deg": [-26.0]}},
        ],
    }
    return Scenario(**(values | changes))
