"""Readers of bags: MCAP's records, and the chunks that hold them."""

import random
import struct
from contextlib import suppress
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.writer import CompressionType
from rclpy.serialization import serialize_message

from fuzz.mutations import spoil_bytes
from fuzz.target import Target
from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_msgs_py.bag.cdr import COMPRESSED_TYPE, RAW_TYPE, picture_of
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg


def _bags(folder: Path) -> list[bytes]:

    files = []
    for number, compression in enumerate((CompressionType.ZSTD, CompressionType.NONE)):
        with BagWriter(folder / f"made{number}", compression=compression) as bag:
            for stamp in (10**18, 10**18 + 5, 10**18 + 9):
                bag.write("/a/camera_info", camera_to_msg(Camera.from_fov(12, 7, 60.0), stamp, "a"), stamp)
                bag.write("/a/pose", pose_to_msg(Pose.from_angles((1.0, 2.0, 3.0), 4.0), stamp), stamp)
        files += [file.read_bytes() for file in (folder / f"made{number}").glob("*.mcap")]
    return files


def _read_bag(folder: Path) -> None:

    reader = BagReader(folder / "a.mcap")
    for message in reader.messages():
        try:
            reader.decode(message)
        except RecordingError:
            continue
    for _ in reader.messages(["/a/pose"], 10**18, 10**18 + 6):
        pass


_RECORD = struct.Struct("<BQ")


def _records(data: bytes) -> list[tuple[int, bytes]]:
    at, found = 8, []
    while at + _RECORD.size <= len(data) - 8:
        opcode, length = _RECORD.unpack_from(data, at)
        found.append((opcode, data[at + _RECORD.size : at + _RECORD.size + length]))
        at += _RECORD.size + length
    return found


def _spoil_bag(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    """Two thirds are spoiled record by record, lengths kept right, and chunks within, to be packed anew."""
    if rng.random() < 0.34:
        return spoil_bytes(rng, data, seeds)
    records = _records(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(records))
        opcode, body = records[at]
        if opcode == 6 and rng.random() < 0.8:
            records[at] = opcode, _chunk(rng, body)
        else:
            way = rng.random()
            if way < 0.7:
                records[at] = opcode, spoil_bytes(rng, body, [body])
            elif way < 0.85:
                records.insert(rng.randrange(len(records)), records[at])
            else:
                records[at] = rng.randrange(256), body
    whole = b"".join(_RECORD.pack(opcode, len(body)) + body for opcode, body in records)
    if rng.random() < 0.5:  # without a summary: the records before are walked over
        whole = whole[: rng.randrange(len(whole) + 1)]
        return data[:8] + whole
    return data[:8] + whole + data[-8:]


def _chunk(rng: random.Random, body: bytes) -> bytes:
    if len(body) < 32:  # its length has been spoiled itself
        return spoil_bytes(rng, body, [body])
    start, end, size, _crc, name_length = struct.unpack_from("<QQQII", body)
    compression = body[32 : 32 + name_length]
    packed = body[32 + name_length + 8 :]
    try:
        inner = zstandard.decompress(packed, max_output_size=size) if compression == b"zstd" else packed
    except (zstandard.ZstdError, MemoryError):  # the size has been spoiled itself
        inner = packed
    way = rng.random()
    if way < 0.6:
        inner = spoil_bytes(rng, inner, [inner])
    elif way < 0.75:
        inner = bytes([rng.choice((0, 5))]) * rng.choice(
            (1000, 60 << 20, 130 << 20)
        )  # empty records, or one without end
    elif way < 0.9:
        inner = (_RECORD.pack(5, 22) + bytes(22)) * rng.choice((10, 2_000_000))
    compression = rng.choice((compression, compression, b"", b"zstd", b"lz4", b"zstd\xff"))
    stated = rng.choice((len(inner), len(inner), 0, 1 << 20, 1 << 45))
    if compression == b"zstd":
        packed = zstandard.compress(inner)
        if rng.random() < 0.15:
            packed = struct.pack("<IBQ", 0xFD2FB528, 0xE0, 1 << 45) + packed[8:]
    elif compression == b"lz4":
        packed = lz4.frame.compress(inner)
    else:
        packed = inner[: 1 << 20]
    head = struct.pack("<QQQII", start, end, stated, 0, len(compression)) + compression
    return head + struct.pack("<Q", len(packed)) + packed


def _pictures(folder: Path) -> list[bytes]:
    photo = np.arange(7 * 12 * 3, dtype=np.uint8).reshape(7, 12, 3)
    sent = compressed_to_msg(encode_rgb(photo), "jpeg", 10**18, "a"), image_to_msg(photo, "rgb8", 10**18, "a")
    return [serialize_message(message) for message in sent]


def _read_picture(folder: Path) -> None:
    for type_name in (COMPRESSED_TYPE, RAW_TYPE):
        with suppress(LtmError):
            picture_of((folder / "picture.cdr").read_bytes(), type_name).rgb()


BAG_FILES = (
    Target("bag", "a.mcap", _bags, _read_bag, _spoil_bag),
    Target("cdr", "picture.cdr", _pictures, _read_picture),
)
