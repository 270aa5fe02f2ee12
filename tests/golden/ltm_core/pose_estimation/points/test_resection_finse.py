"""Surveyed points of a real webcam: a position stated 3 m too low, and few points, marked to 2 pixels."""

from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from ltm_core.tracing.trace_io import PictureConfig, load_picture_config
from ltm_ros.cli.main import cli

STATED = {"x": 419169.2, "y": 6718421.3, "z": 1212.0}
SURVEYED = {"x": 419169.76, "y": 6718421.49, "z": 1215.29}


def fitted(folder: Path, data: Path, names: set[str] | None = None, **pose: float) -> tuple[PictureConfig, str]:
    guess = {"pose": pose, "calibration": {"width": 1920, "height": 1080, "fx": 1484.0}}
    (folder / "guess.yaml").write_text(yaml.safe_dump(guess), encoding="utf-8")
    head, *rows = (data / "finse/gcps_dev.csv").read_text(encoding="utf-8").splitlines()
    kept = [row for row in rows if names is None or row.split(",")[0] in names]
    (folder / "points.csv").write_text("\n".join([head, *kept]), encoding="utf-8")
    files = [str(folder / "points.csv"), "--guess", str(folder / "guess.yaml"), "--out", str(folder / "pose.yaml")]
    result = CliRunner().invoke(cli, ["pose", "points", *files, "--crs", "EPSG:32632"], env={"COLUMNS": "300"})
    if result.exception is not None:
        raise result.exception
    return load_picture_config(folder / "pose.yaml"), result.output


def test_a_position_with_a_sigma_is_fitted(shared_data: Path, tmp_path: Path) -> None:
    """All 45 surveyed points give a pitch of -7.176 and a height of 1215.29 (PROVENANCE.md)."""
    config, _ = fitted(tmp_path, shared_data, position_sigma=3.0, **STATED)
    assert config.pose.pitch_deg == pytest.approx(-7.176, abs=0.05)
    assert config.pose.azimuth_deg == pytest.approx(62.23, abs=0.1)
    assert config.pose.z == pytest.approx(SURVEYED["z"], abs=0.2)


def test_four_points_are_enough_with_it(shared_data: Path, tmp_path: Path) -> None:
    config, _ = fitted(tmp_path, shared_data, {"p3", "p7", "p9", "p21"}, position_sigma=3.0, **STATED)
    assert config.pose.azimuth_deg == pytest.approx(62.23, abs=0.3)
    assert config.calibration.fx == pytest.approx(1423.5, rel=0.02)


def test_a_wrong_position_that_is_held_is_reported(shared_data: Path, tmp_path: Path) -> None:
    """Near points are rejected as outliers; the output states how far the camera would move if it were free."""
    _, said = fitted(tmp_path, shared_data, **STATED)
    assert "p31" in said
    assert "moves by 3." in said
    assert "position_sigma" in said
