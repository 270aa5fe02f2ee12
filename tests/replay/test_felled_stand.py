"""From rendered photos to both maps, with the shipped networks: a wood is felled in view of three cameras."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
import yaml
from rasterio.windows import from_bounds
from typer.testing import CliRunner

from ltm_core.fuel.life_form import LifeForm
from ltm_lab.cli.main import cli
from ltm_lab.resources import lab_config

pytest.importorskip("mitsuba", reason="the simulator's extra is not installed")
pytestmark = pytest.mark.slow

ORIGIN = 380_000.0, 3_806_000.0
FELLED = 454.0, 322.0, 519.0, 422.0
"""Map x, y of the felled part of `felled_44`, on which no constant was chosen."""
SITE = {
    "name": "felled_44",
    "crs": "EPSG:32611",
    "origin": list(ORIGIN),
    "dem": {"path": "bare_earth.tif"},
    "surface": {"path": "surface.tif"},
    "depth_model": "landscape_lite0_depth",
    "terrain": {},
    # Rendered poses are exact, and come without a covariance. By the default, 0.3 degrees, half of the felled cells
    # would be found.
    "expert": {"assumed_pose_error": {"angle_deg": 0.1, "position": 0.3}},
    "fuel": {"prior": "prior.tif"},
    "cameras": {"left": {}, "middle": {}, "right": {}},
}


def run(*arguments: object) -> None:
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recording and site: photos of the date after, an hour apart, four times; the rasters of the date before."""
    folder = tmp_path_factory.mktemp("felled")
    scenario = yaml.safe_load(lab_config("scenarios/felled_44.yaml").read_text())
    scenario["dates"][0]["frames"] = False
    for number, camera in enumerate(scenario["cameras"]):
        camera["patrol"] |= {"rounds": 4, "every_s": 3600.0, "start_s": 0.5 * number}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario))
    run("simulate", folder / "scenario.yaml", "--out", folder / "frames", "--bag", folder / "bag")
    before = folder / "frames/truth/before"
    for name in ("bare_earth.tif", "surface.tif"):
        shutil.copy(before / name, folder / name)
    with rasterio.open(before / "fuel_code.tif") as file:
        codes, profile = file.read(1).astype(np.int16), file.profile
    codes[codes == 255] = -9999
    with rasterio.open(folder / "prior.tif", "w", **(profile | {"dtype": "int16", "nodata": -9999})) as file:
        file.write(codes, 1)
    return folder


def forms(path: Path) -> np.ndarray:
    x, y = ORIGIN
    with rasterio.open(path) as file:
        window = from_bounds(x + FELLED[0], y + FELLED[1], x + FELLED[2], y + FELLED[3], file.transform)
        return np.asarray(file.read(1, window=window.round_offsets().round_lengths()))


@pytest.mark.parametrize(("model", "found_at_least"), [("landscape_lite0", 0.7), ("landscape_v2", 0.5)])
def test_a_felled_wood_is_gone_from_both_maps(
    rendered: Path, tmp_path: Path, model: str, found_at_least: float
) -> None:
    site, scored = rendered / f"{model}.yaml", tmp_path / "score.json"
    site.write_text(yaml.safe_dump(SITE | {"model": model}))
    run("replay", rendered / "bag", "--site", site, "--out", tmp_path / "out", "--offline", "--record")
    truth = "--truth", rendered / "frames", "--date", "after"
    run("eval", "terrain", "--bag", tmp_path / "out/bag", "--site", site, *truth, "--json", scored)
    score = json.loads(scored.read_text())
    assert score["hits"] + score["misses"] > 4000
    assert score["precision"] > 0.8
    assert score["recall"] > found_at_least
    assert score["rmse_after_m"] < 0.6 * score["rmse_before_m"]
    was, now = (
        forms(rendered / "frames/truth/before/life_form.tif"),
        forms(rendered / "frames/truth/after/life_form.tif"),
    )
    found = forms(tmp_path / "out/fuel_map.tif")
    felled = (was != LifeForm.GRASS) & (now == LifeForm.GRASS)
    assert felled.sum() >= 4
    assert (found[felled] == LifeForm.GRASS).all()
