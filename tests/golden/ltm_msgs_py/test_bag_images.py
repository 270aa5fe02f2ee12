"""Images of real recordings: a half grey one is rejected, complete photos are not."""

from pathlib import Path

import pytest

from ltm_core.base.errors import ImageError
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import compressed_to_rgb


def test_a_half_grey_image_of_a_bag_is_rejected(shared_data: Path) -> None:
    reader = BagReader(shared_data / "cases/bags/jpeg_half_grey.mcap")
    images = [reader.decode(m) for m in reader.messages(topics=["/demo/tower_north/image_raw/compressed"])]
    shapes = []
    for number, image in enumerate(images):
        if number == 1:
            with pytest.raises(ImageError, match="truncated or corrupt"):
                compressed_to_rgb(image)
        else:
            shapes.append(compressed_to_rgb(image).shape)
    assert len(shapes) == 2
