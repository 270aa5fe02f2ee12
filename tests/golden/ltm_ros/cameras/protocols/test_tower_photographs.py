"""Photographs of real towers: by day none is taken for night, and none for the picture that was taken before it."""

import itertools
from pathlib import Path

from ltm_ros.cameras.protocols.picture import SAME_SHARE, is_night, same_share, thumbnail_of_bytes


def test_day_is_no_night_and_two_pictures_are_two(shared_data: Path) -> None:
    photos = sorted((shared_data / "hpwren_towers").glob("*.jpg"))
    thumbnails = {path.stem: thumbnail_of_bytes(path.read_bytes()) for path in photos}
    assert len(thumbnails) >= 16
    assert not [name for name, small in thumbnails.items() if is_night(small)]
    assert all(is_night(small // 14) for small in thumbnails.values())
    shares = [same_share(a, b) for a, b in itertools.combinations(thumbnails.values(), 2)]
    # Some are of one camera and one day.
    assert max(shares) < 0.1 < SAME_SHARE
