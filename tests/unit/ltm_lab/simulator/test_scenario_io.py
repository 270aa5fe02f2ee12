"""Scenario files: refusals with their line, paths."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_lab.simulator.scenario_io import load_scenario

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
