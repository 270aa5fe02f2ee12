"""All that is attacked."""

from __future__ import annotations

from fuzz.array_files import ARRAY_FILES
from fuzz.bag_files import BAG_FILES
from fuzz.camera_answers import CAMERA_ANSWERS
from fuzz.capture_files import CAPTURE_FILES
from fuzz.head_answers import HEAD_ANSWERS
from fuzz.messages import MESSAGES
from fuzz.photo_files import PHOTO_FILES
from fuzz.raster_files import RASTER_FILES
from fuzz.region_link import REGION_LINK
from fuzz.self_test import SELF_TEST
from fuzz.store_files import STORE_FILES
from fuzz.target import Target
from fuzz.text_files import TEXT_FILES

TARGETS: tuple[Target, ...] = (
    *(*TEXT_FILES, *PHOTO_FILES, *CAPTURE_FILES, *RASTER_FILES, *STORE_FILES, *BAG_FILES, *ARRAY_FILES),
    *CAMERA_ANSWERS,
    *HEAD_ANSWERS,
    *MESSAGES,
    *REGION_LINK,
)


def target_named(name: str) -> Target:
    return next(target for target in (*TARGETS, SELF_TEST) if target.name == name)
