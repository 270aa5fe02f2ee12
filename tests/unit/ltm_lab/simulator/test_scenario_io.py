from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.storage.config_io import load_yaml
from ltm_lab.simulator.scenario import Scenario

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
        ("[500, 500, 100]", "[950, 500, 100]", None, r"changes\.0 .*outside the site"),
        ("kind: burn", "kind: blaze", 6, "burn"),
        ("kind: burn", "kind: conversion\n    to: redwood", 7, "conifer"),
        ("size: 1000", "size: 1000\n  relif: 3", 5, "unknown key"),
        ("x: 100", "x: 1200", None, r"cameras\.0.*outside the site"),
        ("{circle: [500, 500, 100]}", "{ragged: 3}", 7, "give one of polygon, circle, box"),
        ("seed: 1", "seed: 1\ndates: [{name: b, years: 3}, {name: a}]", None, "in order of years"),
        (
            "seed: 1",
            "seed: 1\ndates: [{name: a}, {name: b, years: 15}]",
            None,
            r"dates\.1 \(b\): 15 years .*past 19 .*2038",
        ),
        ("seed: 1", "seed: 1\ncrs: EPSG:4326", 3, "WGS 84, which is not in metres; give a projected CRS"),
        ("seed: 1", "seed: 1\ncrs: EPSG:2230", 3, "not in metres"),
        ("seed: 1", "seed: 1\ncrs: UTM eleven", 3, "no CRS that PROJ knows; give one such as EPSG:32611"),
        ("seed: 1", "seed: 1\nsmoke: [{x: 40, y: 1040}]", None, r"smoke\.0: the column at \(40, 1040\) is outside"),
        ("size: 1000", "size: 1000\n  surroundings: 800", None, "narrower than the site of 1000 m; give at least 1000"),
        (
            "kind: burn",
            "kind: burn\n    years: 2.5",
            None,
            r"after the last date \(now, year 0\); give a date that sees it",
        ),
        ("seed: 1", "seed: 1\nsun: {elevation_deg: 95}", 3, "sun.elevation_deg: .*less than or equal to 90"),
        ("x: 100, y", "x: 100, sensor: {gps_sigma: -1.5}, y", 9, "gps_sigma: .*greater than or equal to 0"),
    ],
)
def test_bad_scenarios_are_rejected_with_their_place(
    tmp_path: Path, old: str, new: str, line: int | None, says: str
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(BAD.replace(old, new))
    with pytest.raises(ConfigError, match=says) as caught:
        load_yaml(path, Scenario)
    assert str(caught.value).startswith(f"{path}:")
    assert line is None or f"line {line}" in str(caught.value)
