"""Read folders of photos with a pose file as messages of a recording, like those that `ltm import` writes.

In such a folder, `poses.csv` is beside the photos that it lists (`ltm import --write-photos`). Photos stay separate
files, from which they are read again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ltm_core.base.errors import ArchiveError, ConfigError, ImageError, LtmError
from ltm_core.base.number_text import stamp_of_moment
from ltm_core.site.site import Site
from ltm_core.storage.image_io import LARGEST_FILE
from ltm_msgs_py.bag.cdr import COMPRESSED_TYPE, CompressedPicture
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.archive.files import StoredFile
from ltm_ros.recordings.importing.assumptions import Assumptions, Surroundings
from ltm_ros.recordings.importing.georeference import place
from ltm_ros.recordings.importing.photo import POSES, PhotoPose, photo_of, read_pose_file
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, POSE, camera_topic

PHOTOS = (".jpg", ".jpeg", ".png")
"""Suffixes of photos, in lower case."""
_PNG = b"\x89PNG"


def photo_picture(data: bytes, stamp_ns: int) -> CompressedPicture:
    """Return the bytes of a JPEG or PNG file as the image of a message."""
    return CompressedPicture(stamp_ns, "png" if data.startswith(_PNG) else "jpeg", memoryview(data))


@dataclass(frozen=True)
class PlacedMessage:
    """A message of a photo, logged at the photo's stamp. `picture`: the content of an image, with its file; otherwise
    `raw` is the message. `trouble`: why a photo gives none."""

    topic: str
    type_name: str
    stamp_ns: int
    raw: bytes = b""
    file: str = ""
    picture: CompressedPicture | None = None
    trouble: str = ""


def is_pose_list(name: str) -> bool:
    return PurePosixPath(name).name == POSES


def photo_messages(listed: StoredFile, photos: Sequence[StoredFile], site: Site) -> Iterator[PlacedMessage]:
    """Yield messages of the photos in a pose list, in its order; one photo is held at a time.

    Raises ConfigError for an invalid list, OSError if files cannot be read now."""
    rows = read_pose_file(Path(listed.name))
    around = Surroundings(site.frame, site.open_dem(), site.cameras, site.assumed_pose_error)
    there = {PurePosixPath(photo.name).name: photo for photo in photos}
    for name, row in rows.items():
        camera = _camera_of(row, site, listed)
        try:
            if name not in there:
                raise ImageError(f"{listed.name} lists {name}, which does not exist beside it")
            yield from _messages(there[name], row, camera, site, around)
        except (ArchiveError, ConfigError):
            raise
        except LtmError as error:
            stamp = stamp_of_moment(row.stamp) if row.stamp is not None else 0
            topic = camera_topic(site.name, camera, IMAGE_COMPRESSED)
            yield PlacedMessage(topic, COMPRESSED_TYPE, stamp, trouble=str(error))


def _messages(
    photo: StoredFile, row: PhotoPose, camera: str, site: Site, around: Surroundings
) -> Iterator[PlacedMessage]:
    from rclpy.serialization import serialize_message  # loaded late for workers that read no folder

    if photo.size_bytes > LARGEST_FILE:
        raise ImageError(f"{photo.name} has {photo.size_bytes} bytes; the maximum is {LARGEST_FILE >> 20} MiB")
    data = Path(photo.name).read_bytes()
    read = photo_of(data, Path(photo.name))
    if read.reencoded:
        raise ImageError(f"{photo.name} is not stored upright; make a recording of the folder with `ltm import`")
    item = place(read, row, camera, around, Assumptions())
    stamp, optical = item.stamp_ns, f"{camera}_optical"
    for topic, message in (
        (CAMERA_INFO, camera_to_msg(item.camera, stamp, optical)),
        (POSE, pose_to_msg(item.pose, stamp, covariance=item.covariance)),
    ):
        name = camera_topic(site.name, camera, topic)
        yield PlacedMessage(name, type_name_of(message), stamp, serialize_message(message))
    name = camera_topic(site.name, camera, IMAGE_COMPRESSED)
    yield PlacedMessage(name, COMPRESSED_TYPE, stamp, file=photo.name, picture=photo_picture(data, stamp))


def _camera_of(row: PhotoPose, site: Site, listed: StoredFile) -> str:
    if row.camera is None and len(site.cameras) > 1:
        raise ConfigError(
            f"{listed.name}, {row.name}: the site has the cameras {', '.join(site.cameras)}; name the camera in a "
            "column `camera`"
        )
    name = row.camera or next(iter(site.cameras))
    site.camera(name)
    return name
