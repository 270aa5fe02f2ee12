"""Find the recordings of an archive, and scan each once: locations and digests of its images, and all messages joined
to them.

A scan depends only on the file and the topic names, so it is stored and used again while the file is unchanged."""

import hashlib
import json
import os
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from ltm_core.base.errors import ArchiveError, LtmError
from ltm_core.site.site import Site
from ltm_core.storage.disk_io import sync
from ltm_msgs_py.bag.cdr import Picture, picture_of
from ltm_msgs_py.bag.reader import BagMessage, BagReader, is_bag_file
from ltm_ros.recordings.inputs import InputReader, accepted_types, decoded_input, is_image
from ltm_ros.runtime.handler import Topic

SCANS = "scans"
_VERSION = 6
_ABOUT = b"ltm"


def files_below(archive: Path) -> list[Path]:
    """Return a file, or the files in a folder at any depth, by name, also behind links, each folder once; none if
    nothing exists. A broken link, as to an unmounted share, counts as an unreadable file and is not skipped. Raises
    OSError also for an unreadable folder, unlike `Path.rglob`."""
    top = archive.expanduser().resolve()

    def failed(error: OSError) -> None:
        if not (isinstance(error, FileNotFoundError) and error.filename == str(top)):
            raise error

    found, known = [top] if top.is_file() else [], set[str]()
    for place, below, names in os.walk(top, onerror=failed, followlinks=True) if not found else ():
        real = os.path.realpath(place)
        if real in known:  # a link to a parent folder, or to one that is in the archive itself
            below.clear()
            continue
        known.add(real)
        below.sort()
        found += [Path(place) / name for name in names]
    return sorted(path for path in found if path.is_file() or path.is_symlink())


def write_result(path: Path, content: bytes | Path) -> None:
    """Write bytes, or a copy of a file, completely or not at all, also in a power cut. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        if isinstance(content, Path):
            shutil.copyfile(content, partial)
        else:
            partial.write_bytes(content)
        sync(partial)
        partial.replace(path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise


def digest(*parts: object) -> str:
    """Return the digest of values that JSON can write."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def picture_digest(picture: Picture) -> str:
    """Return the digest of an image without its time, because a fixed camera may send the same image again."""
    found = hashlib.blake2b(repr(sorted(picture.about.items())).encode(), digest_size=16)
    found.update(picture.data)
    return found.hexdigest()


@dataclass(frozen=True)
class ScannedMessage:
    """A message of a recording, in the order of log times.

    For an image, `content` is its digest and `trouble` says why it is invalid. For others, `raw` is the message."""

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

    @property
    def size(self) -> tuple[int, int]:
        return self.width, self.height


_KINDS = {str: pa.string(), int: pa.int64(), bytes: pa.binary()}
_SCHEMA = pa.schema([(name, _KINDS[kind]) for name, kind in ScannedMessage.__annotations__.items()])


@dataclass(frozen=True, eq=False)
class Scan:
    """Result of scanning the recording `name`, read on request from the file `kept`. `begins`: log time of the first
    message of each topic. `damage`, `lost`: as in `BagReader`. `recorded`: types of the file's topics."""

    name: str
    kept: Path
    begins: Mapping[str, int]
    damage: tuple[str, ...]
    lost: Mapping[str, int]
    recorded: Mapping[str, str]

    def messages(self, topics: Collection[str]) -> Iterator[ScannedMessage]:
        """Yield messages of some topics, in the order of the recording. Raises OSError."""
        wanted = sorted(self.begins.keys() & set(topics))
        if wanted:
            table = pq.read_table(self.kept, filters=[("topic", "in", wanted)])
            for batch in table.to_batches(5000):
                yield from (ScannedMessage(**row) for row in batch.to_pylist())


def recordings(archives: Sequence[Path]) -> list[Path]:
    """Return the files of bags, in folders at any depth; each once.

    Raises ArchiveError for a place without any, OSError if it cannot be read now."""
    found: dict[Path, None] = {}
    for archive in archives:
        alone = archive.expanduser().is_file()
        inside = [file for file in files_below(archive) if alone or is_bag_file(file.name)]
        if not inside:
            raise ArchiveError(f"{archive}: no recordings (*.mcap, *.db3); make one of photos with `ltm import`")
        found |= dict.fromkeys(inside)
    return list(found)


def scan(file: Path, site: Site, results: Path) -> Scan:
    """Return the scan in `results`, or make and store it now.

    Raises RecordingError for an invalid recording; ArchiveError, OSError if it cannot be read completely now."""
    cameras = ((name, one.image, one.source is None, one.topics.model_dump()) for name, one in site.cameras.items())
    topics = [site.name, *sorted(cameras, key=itemgetter(0))]
    state = file.stat()
    kept = results / SCANS / f"{digest(_VERSION, str(file), state.st_size, state.st_mtime_ns, topics)}.parquet"
    if not kept.exists():
        write_result(kept, _scanned(file, site))
    about: dict[str, Any] = json.loads(pq.read_schema(kept).metadata[_ABOUT])
    return Scan(str(file), kept, about["begins"], tuple(about["damage"]), about["lost"], about["recorded"])


def first_message(scans: Sequence[Scan], name: str, topic: Topic) -> Any:
    """Return the first message of a topic, decoded; None without any. Raises LtmError."""
    found = (message for scan in scans for message in scan.messages([name]) if message.raw)
    message = next(found, None)
    return None if message is None else decoded_input(topic, message.raw, message.type_name)


def _scanned(path: Path, site: Site) -> bytes:
    reader = BagReader(path)
    inputs = InputReader(reader, site)
    topics = inputs.topics
    messages = [_message(message, topics[message.topic]) for message in inputs.messages(topics)]
    if reader.unread:
        raise ArchiveError(f"{path} cannot be read now: {'; '.join(reader.unread)}")
    about = {
        "begins": {message.topic: message.log_time_ns for message in reversed(messages)},
        "damage": reader.damage,
        "lost": {topic: count for topic, count in reader.lost.items() if not topic or topic in topics},
        "recorded": reader.topics(),
    }
    return packed(pa.Table.from_pylist([asdict(message) for message in messages], _SCHEMA), about)


def packed(table: pa.Table, about: Mapping[str, object]) -> bytes:
    """Return a table as Parquet, with JSON about its content."""
    sink = pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata({_ABOUT: json.dumps(about)}), sink, compression="zstd")
    return bytes(sink.getvalue())


def unpacked(path: Path) -> tuple[pa.Table, dict[str, Any]]:
    """Read what `packed` returned, in this thread: for small files, more threads cost more than they save."""
    table = pq.ParquetFile(path).read(use_threads=False)
    return table, json.loads(table.schema.metadata[_ABOUT])


def _message(message: BagMessage, topic: Topic) -> ScannedMessage:
    found = ScannedMessage(message.topic, message.type_name, message.log_time_ns, len(message.raw))
    if message.encoding != "cdr" or message.type_name not in accepted_types(topic):
        supported = " or ".join(accepted_types(topic))
        why = f"{message.topic} has messages of type {message.type_name or 'unknown'} in {message.encoding!r}"
        return replace(found, trouble=f"{why}; supported: {supported} in 'cdr'")
    if not is_image(topic):
        return replace(found, raw=message.raw)
    try:
        picture = picture_of(message.raw, message.type_name)
        width, height = picture.size
    except LtmError as error:
        return replace(found, trouble=str(error))
    content = picture_digest(picture)
    return replace(found, stamp_ns=picture.stamp_ns, width=width, height=height, content=content)
