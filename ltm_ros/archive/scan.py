"""Scan a recording or a folder of photos once: locations and digests of its images, and all messages joined to them.

A scan depends only on the file and the topic names, so it is stored with the results and used again while the file is
unchanged. In a folder of photos, `poses.csv` is beside the photos that it lists (`ltm import --write-photos`)."""

from __future__ import annotations

import heapq
import io
import json
import posixpath
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from operator import attrgetter, itemgetter
from pathlib import Path, PurePosixPath
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from ltm_core.base.errors import ArchiveError, ConfigError, ImageError, LtmError
from ltm_core.base.number_text import stamp_of_moment
from ltm_core.site.site import Site
from ltm_core.storage.image_io import LARGEST_FILE
from ltm_msgs_py.bag.cdr import COMPRESSED_TYPE, CompressedPicture, RawPicture, picture_of
from ltm_msgs_py.bag.reader import BagMessage, BagReader, is_bag_file
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.archive.content_digest import digest, importer_digest, picture_digest, places_digest
from ltm_ros.archive.files import ResultFolder, StoredFile, files_below
from ltm_ros.recordings.importing.assumptions import Assumptions, Surroundings
from ltm_ros.recordings.importing.georeference import place
from ltm_ros.recordings.importing.photo import POSES, PhotoPose, photo_of, read_pose_file
from ltm_ros.recordings.inputs import InputReader, accepted_types, decoded_input, is_image
from ltm_ros.runtime.handler import Topic
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
    from rclpy.serialization import serialize_message  # loaded late: bags need no ROS

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


SCANS = "scans"
_VERSION = 5
_ABOUT = "ltm"
_GROUP = 5_000
"""Number of messages decoded at once."""


@dataclass(frozen=True)
class ScannedMessage:
    """A message of a recording, in the order of log times.

    For an image, `content` is its digest, `stamp_ns` and size are its own, and `raw` is empty; `trouble` says why it is
    invalid; `file`: its own file, if any. For others, `raw` is the message."""

    topic: str
    type_name: str
    log_time_ns: int
    size_bytes: int
    stamp_ns: int = 0
    width: int = 0
    height: int = 0
    content: str = ""
    trouble: str = ""
    file: str = ""
    raw: bytes = b""


_SCHEMA = pa.schema(
    [
        ("order", pa.int64()),
        *((name, pa.string()) for name in ("topic", "type_name")),
        *((name, pa.int64()) for name in ("log_time_ns", "size_bytes", "stamp_ns", "width", "height")),
        *((name, pa.string()) for name in ("content", "trouble", "file")),
        ("raw", pa.binary()),
    ]
)


@dataclass(frozen=True)
class Recording:
    """`name` of an MCAP file, or of the pose list of a folder of photos; `files`: all its files, itself first."""

    files: tuple[StoredFile, ...]

    @property
    def name(self) -> str:
        return self.files[0].name


@dataclass(frozen=True, eq=False)
class Scan:
    """Result of scanning the recording `name`, read on request. `begins`: log time of the first message of each topic.
    `damage`: unreadable parts, in words; `lost`: their messages as in `BagReader.lost`. `recorded`: types of the file's
    topics."""

    name: str
    begins: Mapping[str, int]
    damage: tuple[str, ...]
    lost: Mapping[str, int]
    recorded: Mapping[str, str]
    kept: Callable[[], bytes]

    def messages(self, topics: Collection[str]) -> Iterator[ScannedMessage]:
        """Yield messages of some topics, in the order of the recording, by log time. Raises as `ResultFolder.read`."""
        file = pq.ParquetFile(io.BytesIO(self.kept()))
        groups: dict[str, list[int]] = {}
        for number, topic in enumerate(_about(file)["groups"]):
            groups.setdefault(topic, []).append(number)
        streams = [_of_groups(file, groups[topic]) for topic in sorted(groups.keys() & set(topics))]
        for _, message in heapq.merge(*streams, key=itemgetter(0)):
            yield message


def recordings(archives: Sequence[Path]) -> list[Recording]:
    """Return the MCAP files of bags, and the folders of photos with a pose list, in folders at any depth; each once, by
    name.

    Raises ArchiveError for a place without any, OSError if it cannot be read now."""
    found: dict[str, Recording] = {}
    for archive in archives:
        below = files_below(archive)
        alone = archive.expanduser().is_file()
        bags = (file for file in below if is_bag_file(file.name) or (alone and not is_pose_list(file.name)))
        inside = [Recording((file,)) for file in bags]
        for listed in (file for file in below if is_pose_list(file.name)):
            folder = posixpath.dirname(listed.name)
            photos = (f for f in below if posixpath.dirname(f.name) == folder and f.name.lower().endswith(PHOTOS))
            inside.append(Recording((listed, *photos)))
        if not inside:
            raise ArchiveError(
                f"{archive}: contains no recordings (*.mcap, *.db3) and no photos with a {POSES}; convert other photos "
                "with `ltm import`"
            )
        found.update({recording.name: recording for recording in inside})
    return list(found.values())


def scan(recording: Recording, site: Site, results: ResultFolder) -> Scan:
    """Return the scan in `results`, or make and store it now.

    Raises RecordingError for an invalid recording; ArchiveError, OSError if it cannot be read completely now: then
    nothing is stored."""
    state = [[file.name, file.size_bytes, file.version] for file in recording.files]
    placed = [importer_digest(), places_digest(site)] if is_pose_list(recording.name) else []
    name = f"{SCANS}/{digest(_VERSION, state, _topics_of(site), placed)}.parquet"
    if not results.has(name):
        if is_pose_list(recording.name):
            photos = photo_messages(recording.files[0], recording.files[1:], site)
            placed_messages = sorted(map(_of_photo, photos), key=attrgetter("log_time_ns"))
            results.write(name, _packed(placed_messages))
        else:
            results.write(name, _scanned_bag(recording.name, site))
    about = _about(pq.ParquetFile(io.BytesIO(results.read(name))))
    damage, kept = tuple(about["damage"]), lambda: results.read(name)
    return Scan(recording.name, about["begins"], damage, about["lost"], about["recorded"], kept)


def _topics_of(site: Site) -> list[object]:
    """Return what decides which topics of a recording are read."""
    cameras = ((name, one.image, one.source is None, one.topics.model_dump()) for name, one in site.cameras.items())
    return [site.name, *sorted(cameras, key=itemgetter(0))]


def first_message(scans: Sequence[Scan], name: str, topic: Topic) -> Any:
    """Return the first message of a topic, decoded; None without any. Raises LtmError."""
    found = (message for scan in scans if name in scan.begins for message in scan.messages([name]) if message.raw)
    message = next(found, None)
    return None if message is None else decoded_input(topic, message.raw, message.type_name)


def _scanned_bag(name: str, site: Site) -> bytes:
    reader = BagReader(Path(name))
    inputs = InputReader(reader, site)
    topics = inputs.topics
    messages = [_scanned(message, topics[message.topic]) for message in inputs.messages(topics)]
    if reader.unread:
        raise ArchiveError(f"{name} cannot be read now: {'; '.join(reader.unread)}")
    lost = {topic: count for topic, count in reader.lost.items() if not topic or topic in topics}
    return _packed(messages, reader.damage, lost, reader.topics())


def _scanned(message: BagMessage, topic: Topic) -> ScannedMessage:
    found = ScannedMessage(message.topic, message.type_name, message.log_time_ns, len(message.raw))
    if message.encoding != "cdr" or message.type_name not in accepted_types(topic):
        supported = " or ".join(accepted_types(topic))
        why = f"{message.topic} has messages of type {message.type_name or 'unknown'} in {message.encoding!r}"
        return replace(found, trouble=f"{why}; supported: {supported} in 'cdr'")
    if not is_image(topic):
        return replace(found, raw=message.raw)
    try:
        return _with_picture(found, picture_of(message.raw, message.type_name))
    except LtmError as error:
        return replace(found, trouble=str(error))


def _of_photo(message: PlacedMessage) -> ScannedMessage:
    size = len(message.raw if message.picture is None else message.picture.data)
    found = ScannedMessage(message.topic, message.type_name, message.stamp_ns, size, trouble=message.trouble)
    if message.picture is None:
        return replace(found, raw=message.raw)
    return replace(_with_picture(found, message.picture), file=message.file)


def _with_picture(message: ScannedMessage, picture: CompressedPicture | RawPicture) -> ScannedMessage:
    width, height = picture.size
    content = picture_digest(picture)
    return replace(message, stamp_ns=picture.stamp_ns, width=width, height=height, content=content)


def _packed(
    messages: Sequence[ScannedMessage],
    damage: Sequence[str] = (),
    lost: Mapping[str, int] | None = None,
    recorded: Mapping[str, str] | None = None,
) -> bytes:
    """Pack row groups of one topic each, so that cameras can be read separately."""
    by_topic: dict[str, list[dict[str, Any]]] = {}
    for order, message in enumerate(messages):
        by_topic.setdefault(message.topic, []).append({"order": order, **asdict(message)})
    groups = [(topic, rows[at : at + _GROUP]) for topic, rows in by_topic.items() for at in range(0, len(rows), _GROUP)]
    begins = {topic: rows[0]["log_time_ns"] for topic, rows in by_topic.items()}
    about: dict[str, object] = {"groups": [topic for topic, _ in groups], "begins": begins, "damage": list(damage)}
    about |= {"lost": lost or {}, "recorded": recorded or {}}
    file, schema = io.BytesIO(), _SCHEMA.with_metadata({_ABOUT: json.dumps(about)})
    with pq.ParquetWriter(file, schema, compression="zstd") as writer:
        for _, rows in groups:
            writer.write_table(pa.Table.from_pylist(rows, schema))
    return file.getvalue()


def _about(file: pq.ParquetFile) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(file.schema_arrow.metadata[_ABOUT.encode()])
    return found


def _of_groups(file: pq.ParquetFile, groups: Sequence[int]) -> Iterator[tuple[int, ScannedMessage]]:
    for number in groups:
        for row in file.read_row_group(number).to_pylist():
            yield row.pop("order"), ScannedMessage(**row)
