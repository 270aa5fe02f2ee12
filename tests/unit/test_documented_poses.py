from __future__ import annotations

import re
from pathlib import Path

import yaml

from ltm_core.site.sections import CameraConfig
from ltm_core.tracing.trace_io import load_picture_config
from ltm_ros.recordings.importing.photo import read_pose_file

PAGE = (Path(__file__).parents[2] / "docs/poses.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(yaml|csv)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_examples_are_read(tmp_path: Path) -> None:
    read = []
    for number, (kind, text) in enumerate(BLOCKS):
        path = tmp_path / f"{number}.{kind}"
        path.write_text(text)
        content = yaml.safe_load(text) if kind == "yaml" else None
        if isinstance(content, dict) and "cameras" in content:
            camera = CameraConfig.model_validate(content["cameras"]["north"])
            assert camera.pose is not None
            assert camera.pose.azimuth_sigma_deg == 0.2
            read.append("site")
        elif content == {"refine_poses": {}}:
            read.append("section of a site")
        elif isinstance(content, dict):
            assert load_picture_config(path).calibration.distortion == (-0.12, 0, 0, 0, 0)
            read.append("pose file")
        else:
            read.append(kind)
            assert read_pose_file(path)
    assert read == ["section of a site", "site", "pose file", "csv", "csv", "yaml"]


def test_both_photo_lists_say_the_same(tmp_path: Path) -> None:
    first, second, listed = ([text for kind, text in BLOCKS][k] for k in (3, 4, 5))
    for name, text in (("first.csv", first), ("second.csv", second), ("listed.yaml", listed)):
        (tmp_path / name).write_text(text)
    both = read_pose_file(tmp_path / "listed.yaml")
    assert both["ridge_0900.jpg"] == read_pose_file(tmp_path / "second.csv")["ridge_0900.jpg"]
    phone = read_pose_file(tmp_path / "first.csv")["IMG_1.jpg"]
    assert phone.stamp == both["IMG_1.jpg"].stamp
    assert phone.pose.model_copy(update={"azimuth_sigma_deg": None}) == both["IMG_1.jpg"].pose
