"""Looks through a recording once: where its pictures are and what their content is, and all that is joined to them.

What a scan finds hangs on the file and the names of topics alone, so it is kept beside the results and read again as
long as the file is the same.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from ltm_core.errors import ArchiveError, LtmError
from ltm_core.site import Site
from ltm_msgs_py.bag.picture_cdr import picture_of
from ltm_msgs_py.bag.reader import BagMessage, BagReader
from ltm_ros.archive.content_digest import digest, picture_digest
from ltm_ros.archive.results import ResultFolder
from ltm_ros.runtime.topics import CAMERA_INPUTS, IMAGE_COMPRESSED, IMAGE_RAW, camera_topic

SCANS = "scans"
_VERSION = 1
_PICTURES = (IMAGE_COMPRESSED.name, IMAGE_RAW.name)


@dataclass(frozen=True)
class ScannedMessage:
    """A message of a recording, in the order of log times.

    Of a picture `content` is its digest, `stamp_ns` and size are stated in it, and `raw` is empty; `trouble` says why
    it is none. Of all else `raw` is the message itself.
    """

    topic: str
    type_name: str
    log_time_ns: int
    size_bytes: int
    stamp_ns: int = 0
    width: int = 0
    height: int = 0
    content: str = ""
    trouble: str = ""
    raw: bytes = b""


_SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("topic", "type_name")),
        *((name, pa.int64()) for name in ("log_time_ns", "size_bytes", "stamp_ns", "width", "height")),
        *((name, pa.string()) for name in ("content", "trouble")),
        ("raw", pa.binary()),
    ]
)


@dataclass(frozen=True)
class Scan:
    """`damage`: what of the file could not be read, in words."""

    file: Path
    messages: tuple[ScannedMessage, ...]
    damage: tuple[str, ...]


def recordings(archives: list[Path]) -> list[Path]:
    """The MCAP files of bags, and of folders that hold bags at any depth; each once, in the order of their names.

    Raises ArchiveError for a place that holds none.
    """
    found: dict[Path, None] = {}
    for archive in archives:
        inside = [archive] if archive.is_file() else sorted(archive.rglob("*.mcap"))
        if not inside:
            raise ArchiveError(
                f"{archive}: holds no recordings (*.mcap); photos and their poses become one with `ltm import`"
            )
        found.update(dict.fromkeys(file.resolve() for file in inside))
    return list(found)


def scan(file: Path, site: Site, results: ResultFolder) -> Scan:
    """Of one MCAP file: as kept in `results`, or made and kept now. Raises RecordingError for what is no recording."""
    state = file.stat()
    topics = {camera_topic(site.name, camera, topic): topic.name for camera in site.cameras for topic in CAMERA_INPUTS}
    key = digest(_VERSION, str(file), state.st_size, state.st_mtime_ns, sorted(topics))
    name = f"{SCANS}/{key}.parquet"
    if results.has(name):
        return _read(file, results.read(name))
    reader = BagReader(file)
    messages = tuple(_scanned(message, topics[message.topic]) for message in _inputs(reader, set(topics)))
    found = Scan(file, messages, reader.damage)
    results.write(name, _packed(found))
    return found


def _inputs(reader: BagReader, topics: set[str]) -> Iterator[BagMessage]:
    return reader.messages(topics & reader.topics().keys())


def _scanned(message: BagMessage, topic: str) -> ScannedMessage:
    found = ScannedMessage(message.topic, message.type_name, message.log_time_ns, len(message.raw))
    if topic not in _PICTURES:
        return replace(found, raw=message.raw)
    try:
        picture = picture_of(message.raw, message.type_name)
        width, height = picture.size
    except LtmError as error:
        return replace(found, trouble=str(error))
    content = picture_digest(message.raw)
    return replace(found, stamp_ns=picture.stamp_ns, width=width, height=height, content=content)


def _packed(found: Scan) -> bytes:
    table = pa.Table.from_pylist([asdict(message) for message in found.messages], _SCHEMA)
    file = io.BytesIO()
    pq.write_table(table.replace_schema_metadata({"damage": "\n".join(found.damage)}), file, compression="zstd")
    return file.getvalue()


def _read(file: Path, content: bytes) -> Scan:
    table = pq.read_table(io.BytesIO(content))
    damage = (table.schema.metadata or {}).get(b"damage", b"").decode()
    return Scan(
        file, tuple(ScannedMessage(**row) for row in table.to_pylist()), tuple(filter(None, damage.split("\n")))
    )
