"""What names results: the same in every process, and another one whenever what goes into them is."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from rclpy.serialization import serialize_message
from scenes.masked_site import hidden_of_view, write_turning_site
from scenes.small_site import write_small_site

import ltm_ros.archive
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.vision.masks import write_mask
from ltm_msgs_py.bag.cdr import RAW_TYPE, picture_of
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import image_to_msg
from ltm_ros.archive.manifest import ArchiveFrame, ArchiveImageReader
from ltm_ros.archive.plan import code_digest, file_digest, site_digest
from ltm_ros.archive.scan import picture_digest

_SAYS = """
import sys
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_core.site.site_io import load_site
from ltm_ros.archive.plan import site_digest
print(site_digest(load_site(sys.argv[1]), "mast", TracingConfig(), LabellingConfig()))
"""

CAMERA, POSE = Camera.from_fov(6, 4, 60.0), Pose.from_angles((0, 0, 0), 0.0)


def test_digests_are_the_same_in_every_process(tmp_path: Path) -> None:
    """Else a run that is resumed makes the evidence of all its tasks again: sets have another order in each."""
    site = write_small_site(tmp_path, recording=False)
    said = set()
    for seed in ("1", "2"):
        command = [sys.executable, "-c", _SAYS, str(site.path)]
        ended = subprocess.run(command, env=os.environ | {"PYTHONHASHSEED": seed}, capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr
        said.add(ended.stdout)
    assert len(said) == 1


def test_other_errors_of_the_network_give_other_evidence(tmp_path: Path) -> None:
    site = write_small_site(tmp_path, recording=False)
    content = yaml.safe_load(site.path.read_text())
    found = []
    for wrong in (0.1, 0.2):
        errors = {"source": "made up", "shares": {"grass": {"grass": 1 - wrong, "built": wrong}}}
        (tmp_path / "errors.yaml").write_text(yaml.safe_dump(errors))
        content["expert"] = {"fuel": {"label_errors": str(tmp_path / "errors.yaml")}}
        site.path.write_text(yaml.safe_dump(content))
        found.append(_name(load_site(site.path), "mast"))
    assert found[0] != found[1]


def test_masks_of_views_are_in_the_names_of_their_camera_alone(tmp_path: Path) -> None:
    """None, one, and the same file with another mask in it."""
    small = write_small_site(tmp_path, recording=False)
    site, turning = load_site(small.path), load_site(write_turning_site(small))
    found = {camera: [_name(site, camera), _name(turning, camera)] for camera in ("tower", "mast")}
    write_mask(tmp_path / "view_mask.png", ~hidden_of_view())
    for camera, names in found.items():
        names.append(_name(turning, camera))
    assert {camera: len(set(names)) for camera, names in found.items()} == {"tower": 3, "mast": 1}


def _name(site: Site, camera: str) -> str:
    return site_digest(site, camera, TracingConfig(), LabellingConfig())


def test_limits_of_growth_are_in_the_names_of_votes(tmp_path: Path) -> None:
    small = write_small_site(tmp_path, recording=False)
    content = yaml.safe_load(small.path.read_text())
    found = {_name(small.site, "mast")}
    for steepest in (49.0, None):
        changes = {"expert": {"fuel": {"steepest_deg": steepest}}}
        small.path.write_text(yaml.safe_dump(content | changes))
        found.add(_name(load_site(small.path), "mast"))
    assert len(found) == 3


def test_the_program_is_its_own_sources_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = code_digest.__wrapped__()
    (own,) = ltm_ros.archive.__path__
    shutil.copytree(own, tmp_path / "archive")
    monkeypatch.setattr(ltm_ros.archive, "__path__", [str(tmp_path / "archive")])
    assert code_digest.__wrapped__() == before
    with (tmp_path / "archive/task.py").open("a") as file:
        file.write("# another\n")
    assert code_digest.__wrapped__() != before


def test_a_folder_is_what_its_files_hold(tmp_path: Path) -> None:
    (tmp_path / "map").mkdir()
    file = tmp_path / "map" / "band.tif"
    file.write_bytes(b"before")
    before = file_digest(tmp_path / "map")
    state = (tmp_path / "map").stat()
    file.write_bytes(b"and after")
    os.utime(tmp_path / "map", ns=(state.st_atime_ns, state.st_mtime_ns))
    assert file_digest(tmp_path / "map") != before


def test_a_message_of_the_same_time_that_is_none_spoils_no_picture(tmp_path: Path) -> None:
    raw = serialize_message(image_to_msg(np.full((4, 6, 3), 9, np.uint8), "rgb8", 7, "east_optical"))
    with BagWriter(tmp_path / "bag") as bag:
        for content in (raw[:11], raw):
            bag.write_raw("/a/east/image_raw", RAW_TYPE, content, 50)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    wanted = picture_digest(picture_of(raw, RAW_TYPE))
    frame = ArchiveFrame("east", 7, str(file), "/a/east/image_raw", 50, len(raw), wanted, CAMERA, POSE, np.eye(6))
    assert ArchiveImageReader().read(frame).size == (6, 4)
