import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from PIL import Image
from scenes.command_line import ltm
from scenes.mountain_view import CAMERA, ORIGIN, TRUE, eye, view, write_site

from ltm_core.geometry.pose import Pose
from ltm_core.tracing.trace_io import load_picture_config
from ltm_core.vision.labels import Label
from ltm_core.vision.segmenter import Segmenter


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photo")
    write_site(folder)
    photo, labels = view(TRUE)
    (folder / "photos").mkdir()
    Image.fromarray(photo).save(folder / "photos" / "a.png")
    Image.fromarray(labels).save(folder / "labels.png")
    (folder / "guess.yaml").write_text(yaml.safe_dump(guess()), encoding="utf-8")
    return folder


def guess(**changed: object) -> dict[str, object]:
    x, y, z = TRUE.position
    known = {"x": float(x + ORIGIN[0]), "y": float(y + ORIGIN[1]), "z": float(z), "azimuth_deg": 65.5}
    known |= {
        "pitch_deg": 2.0,
        "roll_deg": 1.0,
        "azimuth_sigma_deg": 3.0,
        "pitch_sigma_deg": 0.5,
        "roll_sigma_deg": 0.5,
    }
    calibration = {"width": CAMERA.width, "height": CAMERA.height, "fx": CAMERA.fx}
    return {"pose": known | changed, "calibration": calibration, "possible_ground": {"highest": -10000.0}}


def run(files: Path, *arguments: str, code: int = 0) -> str:
    return ltm("pose", "photo", "--dem", files / "dem.tif", *arguments, status=code)


def test_a_photo_gives_pose_picture_and_figures(files: Path, tmp_path: Path) -> None:
    out, picture, report = tmp_path / "found.yaml", tmp_path / "fit.png", tmp_path / "fit.json"
    arguments = [str(files / "photos/a.png"), "--guess", str(files / "guess.yaml"), "-o", str(out)]
    arguments += ["--labels", str(files / "labels.png"), "--picture", str(picture), "--report", str(report)]
    assert "accepted" in run(files, *arguments)
    pose = load_picture_config(out).pose
    assert pose.azimuth_deg == pytest.approx(63.0, abs=0.1)
    assert pose.pitch_deg == pytest.approx(2.5, abs=0.1)
    assert pose.azimuth_sigma_deg is not None
    assert 0.01 < pose.azimuth_sigma_deg < 0.5
    assert out.read_text().startswith("# Pose from the photo: accepted")
    figures = json.loads(report.read_text())
    assert figures["verdict"] == "accepted"
    assert np.array(figures["result"]["covariance"]).shape == (6, 6)
    assert figures["given"]["azimuth_deg"] == pytest.approx(65.5)
    with Image.open(picture) as drawn:
        assert drawn.size == (CAMERA.width, 2 * CAMERA.height), "as given, and as found"


def test_a_pose_that_is_not_accepted_is_the_given_one_or_none(files: Path, tmp_path: Path) -> None:
    """Fog: the given pose is written; without a given azimuth there is nothing to write. Exit code 3 in both cases."""
    Image.fromarray(np.zeros((CAMERA.height, CAMERA.width), np.uint8)).save(tmp_path / "fog.png")
    Image.fromarray(np.full((CAMERA.height, CAMERA.width, 3), 190, np.uint8)).save(tmp_path / "a.png")
    arguments = [str(tmp_path / "a.png"), "--labels", str(tmp_path / "fog.png"), "--guess"]
    run(files, *arguments, str(files / "guess.yaml"), "-o", str(tmp_path / "kept.yaml"), code=3)
    assert load_picture_config(tmp_path / "kept.yaml").pose.azimuth_deg == pytest.approx(65.5)
    unknown = guess()
    del unknown["pose"]["azimuth_deg"]  # type: ignore[attr-defined]
    (tmp_path / "unknown.yaml").write_text(yaml.safe_dump(unknown), encoding="utf-8")
    report = tmp_path / "report.json"
    arguments += [str(tmp_path / "unknown.yaml"), "-o", str(tmp_path / "none.yaml"), "--report", str(report)]
    run(files, *arguments, code=3)
    assert not (tmp_path / "none.yaml").exists()
    assert json.loads(report.read_text())["verdict"] != "accepted"


def test_many_photos_by_a_list(files: Path, tmp_path: Path) -> None:
    row = guess()["pose"]
    assert isinstance(row, dict)
    table = row | {"width": CAMERA.width, "height": CAMERA.height, "fx": CAMERA.fx}
    lines = ["name," + ",".join(table), "a.png," + ",".join(map(str, table.values()))]
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    arguments = [str(files / "photos"), "--guess", str(tmp_path / "poses.csv")]
    run(files, *arguments, "--labels", str(files / "labels.png"), "-o", str(tmp_path / "out"))
    assert (tmp_path / "out" / "a.yaml").is_file()


@pytest.mark.slow
def test_photos_of_one_camera_share_an_unknown_lens(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The guess states no distortion; the lens has k1 -0.2, without which no pose is within half a degree."""
    sky = view(TRUE)[0][0, 0]
    by_color = SimpleNamespace(
        segment=lambda photo: SimpleNamespace(labels=np.where((photo == sky).all(axis=2), Label.SKY, Label.BARE))
    )
    monkeypatch.setattr(Segmenter, "open", lambda *_: by_color)
    lens = replace(CAMERA, distortion=(-0.2, 0.0, 0.0, 0.0, 0.0))
    row = guess()["pose"]
    assert isinstance(row, dict)
    lines = ["name,width,height,fx," + ",".join(row)]
    for k, azimuth in enumerate((63.0, 70.0)):
        Image.fromarray(view(Pose.from_angles(eye(), azimuth, 2.5, 1.2), lens)[0]).save(tmp_path / f"{k}.png")
        stated = row | {"azimuth_deg": azimuth + 2.5}
        lines.append(",".join(map(str, (f"{k}.png", CAMERA.width, CAMERA.height, CAMERA.fx, *stated.values()))))
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    arguments = [str(tmp_path), "--guess", str(tmp_path / "poses.csv"), "--mount", "--free", "lens"]
    run(files, *arguments, "-o", str(tmp_path / "out"))
    found = [load_picture_config(tmp_path / "out" / f"{k}.yaml") for k in range(2)]
    assert {f.calibration.k1 for f in found} == {found[0].calibration.k1}
    assert found[0].calibration.k1 == pytest.approx(-0.2, abs=0.03)
    assert [f.pose.azimuth_deg for f in found] == pytest.approx([63.0, 70.0], abs=0.1)
    assert [f.pose.pitch_deg for f in found] == pytest.approx([2.5, 2.5], abs=0.1)
