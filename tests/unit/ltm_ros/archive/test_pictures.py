"""Pictures of an archive: found again, and whether they are clear, by one that is decoded small."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from rclpy.serialization import serialize_message
from scenes.small_site import TOWER, write_small_site

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.pose import Pose
from ltm_core.site.site_io import load_site
from ltm_core.vision.masks import write_mask
from ltm_msgs_py.bag.picture_cdr import RAW_TYPE, RawPicture, picture_of
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import image_to_msg
from ltm_ros.archive.content_digest import picture_digest
from ltm_ros.archive.files import ArchiveFiles, CacheConfig
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.pictures import ArchiveImageReader, SmallLook


class _Pictures(ArchiveImageReader):
    """Gives one picture for all frames."""

    def __init__(self, rgb: UInt8Array) -> None:
        super().__init__(ArchiveFiles(CacheConfig()))
        self._rgb = rgb

    def read(self, frame: ArchiveFrame) -> RawPicture:
        height, width, _ = self._rgb.shape
        return RawPicture(frame.stamp_ns, height, width, "rgb8", 0, 3 * width, memoryview(self._rgb.tobytes()))


@pytest.mark.parametrize(("azimuth_deg", "clear"), [(40.0, False), (60.0, True)])
def test_what_a_view_s_mask_hides_is_not_judged(tmp_path: Path, azimuth_deg: float, clear: bool) -> None:
    """A grey picture but for a roof of many colours, which one view hides."""
    small = write_small_site(tmp_path, recording=False)
    roof = np.zeros((TOWER.height, TOWER.width), np.bool_)
    roof[60:, 80:] = True
    write_mask(tmp_path / "roof.png", roof)
    content = yaml.safe_load(small.path.read_text())
    view = {"name": "roof", "azimuth_deg": 40.0, "pitch_deg": -14.0, "mask": "roof.png"}
    content["cameras"]["tower"]["view_masks"] = [view]
    small.path.write_text(yaml.safe_dump(content))
    picture = np.full((TOWER.height, TOWER.width, 3), 120, np.uint8)
    picture[roof] = np.random.default_rng(3).integers(60, 200, (int(roof.sum()), 3), np.uint8)
    pose = Pose.from_angles((560.0, 470.0, 300.0), azimuth_deg, -14.0)
    lens = (TOWER.width, TOWER.height, TOWER.fx, TOWER.fy, TOWER.cx, TOWER.cy, *TOWER.distortion)
    frame = ArchiveFrame("tower", 1, "a.mcap", "", 1, 5, "", lens, (), (), ())
    frame = replace(frame, position=tuple(pose.position), quaternion=tuple(pose.quaternion))
    look = SmallLook(load_site(small.path), "tower", _Pictures(picture))
    assert (look(frame) == "") == clear


def test_a_dim_picture_is_clear_at_noon_alone(tmp_path: Path) -> None:
    """As live: the site is in California."""
    small = write_small_site(tmp_path, recording=False)
    dim = np.random.default_rng(3).integers(20, 140, (TOWER.height, TOWER.width, 3), np.uint8)
    look = SmallLook(load_site(small.path), "tower", _Pictures(dim))
    said = []
    for moment in ("2026-06-21T20:00", "2026-06-22T04:00"):
        stamp = int(np.datetime64(moment, "ns").astype(np.int64))
        lens = (TOWER.width, TOWER.height, TOWER.fx, TOWER.fy, TOWER.cx, TOWER.cy, *TOWER.distortion)
        said.append(look(ArchiveFrame("tower", stamp, "", "", 1, 5, "", lens, (0.0,) * 3, (0.0, 0.0, 0.0, 1.0), ())))
    assert said == ["", "dusk: the sun is low and the image dim"]


def test_a_message_of_the_same_time_that_is_none_spoils_no_picture(tmp_path: Path) -> None:
    raw = serialize_message(image_to_msg(np.full((4, 6, 3), 9, np.uint8), "rgb8", 7, "east_optical"))
    with BagWriter(tmp_path / "bag") as bag:
        for content in (raw[:11], raw):
            bag.write_raw("/a/east/image_raw", RAW_TYPE, content, 50)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    wanted = picture_digest(picture_of(raw, RAW_TYPE))
    frame = ArchiveFrame("east", 7, str(file), "/a/east/image_raw", 50, len(raw), wanted, (), (), (), ())
    with ArchiveImageReader(ArchiveFiles(CacheConfig())) as reader:
        assert reader.read(frame).size == (6, 4)
