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
            assert load_picture_config(path).calibration.k1 == -0.12
            read.append("pose file")
        else:
            read.append(kind)
            assert read_pose_file(path)
    assert read == ["section of a site", "site", "pose file", "csv", "csv"]
