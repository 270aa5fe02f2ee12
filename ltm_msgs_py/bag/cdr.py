"""Decode serialised images without the middleware, which loads slowly, and tf2_msgs/TFMessage, which has no wheel.

The layout is plain CDR (OMG DDS-XTypes 1.3, 7.4.1): four bytes of encapsulation, then the fields, numbers aligned to
their size, strings (with a closing zero) and sequences after a uint32 of their length."""

import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from geometry_msgs.msg import TransformStamped

from ltm_core.base.errors import ImageError, RecordingError
from ltm_core.base.types import UInt8Array
from ltm_msgs_py.image import compressed_size, compressed_to_rgb, msg_to_rgb
from ltm_msgs_py.pose import link_transform, mount_transform
from ltm_msgs_py.stamp import NS_PER_S, make_header

COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"
RAW_TYPE = "sensor_msgs/msg/Image"
TF_TYPE = "tf2_msgs/msg/TFMessage"
_HEAD = 4
"""Bytes of encapsulation; alignment counts from their end."""


@dataclass(frozen=True)
class Picture:
    """An image as sent. `about`: the fields of CompressedImage or Image besides header and data."""

    stamp_ns: int
    about: dict[str, Any]
    data: memoryview

    @property
    def _message(self) -> Any:
        return SimpleNamespace(data=self.data, **self.about)

    @property
    def size(self) -> tuple[int, int]:
        """Return (width, height); of a compressed image, as it states. Raises ImageError."""
        about = self.about
        return compressed_size(self._message) if "format" in about else (about["width"], about["height"])

    def rgb(self) -> UInt8Array:
        """Return (H, W, 3). Raises ImageError."""
        return (compressed_to_rgb if "format" in self.about else msg_to_rgb)(self._message)


def picture_of(raw: bytes, type_name: str) -> Picture:
    """Return the image of a serialised message. Raises RecordingError for invalid bytes, ImageError if none."""
    if type_name not in (COMPRESSED_TYPE, RAW_TYPE):
        raise ImageError(f"{type_name} contains no image; supported: {COMPRESSED_TYPE} and {RAW_TYPE}")
    try:
        fields = _Fields(raw)
        stamp = fields.stamp_ns()
        fields.text()  # frame_id
        if type_name == COMPRESSED_TYPE:
            return Picture(stamp, {"format": fields.text()}, fields.data())
        about = {"height": fields.number("I"), "width": fields.number("I"), "encoding": fields.text()}
        about |= {"is_bigendian": fields.number("B"), "step": fields.number("I")}
        return Picture(stamp, about, fields.data())
    except (struct.error, ValueError) as error:
        raise RecordingError(f"{len(raw)} bytes do not decode as {type_name} ({error})") from error


def header_of(raw: bytes) -> tuple[int, str]:
    """Return stamp (ns) and frame of a serialised message that begins with a header. Raises RecordingError."""
    try:
        fields = _Fields(raw)
        return fields.stamp_ns(), fields.text()
    except (struct.error, ValueError) as error:
        raise RecordingError(f"{len(raw)} bytes have no header ({error})") from error


@dataclass(frozen=True)
class Transforms:
    """The fields of TFMessage."""

    transforms: list[TransformStamped]


def transforms_of(raw: bytes) -> list[TransformStamped]:
    """Return the transforms of a serialised TFMessage. Raises RecordingError, MessageError for an invalid stamp."""
    found = []
    try:
        fields = _Fields(raw)
        for _ in range(fields.number("I")):
            header = make_header(fields.stamp_ns(), fields.text())
            one = TransformStamped(header=header, child_frame_id=fields.text())
            move, turn = one.transform.translation, one.transform.rotation
            move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w = (fields.number("d") for _ in range(7))
            found.append(one)
    except (struct.error, ValueError) as error:
        raise RecordingError(f"{len(raw)} bytes do not decode as {TF_TYPE} ({error})") from error
    return found


def transforms_to_raw(transforms: Iterable[TransformStamped]) -> bytes:
    """Return a serialised TFMessage."""
    transforms = list(transforms)
    data = bytearray(struct.pack("<I", len(transforms)))
    for one in transforms:
        stamp, move, turn = one.header.stamp, one.transform.translation, one.transform.rotation
        data += bytes(-len(data) % 4) + struct.pack("<iI", stamp.sec, stamp.nanosec)
        for text in (one.header.frame_id, one.child_frame_id):
            encoded = text.encode() + b"\0"
            data += bytes(-len(data) % 4) + struct.pack("<I", len(encoded)) + encoded
        data += bytes(-len(data) % 8)
        data += struct.pack("<7d", move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w)
    return b"\0\1\0\0" + bytes(data)


class CameraFrames:
    """Makes the transforms of a recording from the poses of its cameras (REP-105): `map` to each camera's link at each
    pose, and once, before the first, from the links to the optical frames.

    `cameras`: by the absolute topic of their poses."""

    def __init__(self, cameras: Mapping[str, str]) -> None:
        self._cameras = dict(cameras)
        self._mounted = False

    def beside(self, topic: str, message: Any) -> Iterator[tuple[str, bytes, bool]]:
        """Yield topic, serialised TFMessage and whether it is latched, for a message of any topic."""
        if (camera := self._cameras.get(topic)) is None or message.header.frame_id != "map":
            return
        if not self._mounted:
            self._mounted = True
            yield "/tf_static", transforms_to_raw(map(mount_transform, sorted({*self._cameras.values()}))), True
        yield "/tf", transforms_to_raw([link_transform(camera, message)]), False


class _Fields:
    """Reads one field after the other. Raises ValueError and struct.error past the end."""

    def __init__(self, raw: bytes) -> None:
        if len(raw) < _HEAD or raw[0] != 0 or raw[1] not in (0, 1):
            raise ValueError(f"they begin with {raw[:_HEAD].hex(' ') or 'nothing'}, expected CDR (00 00 or 00 01)")
        self._order, self._bytes, self._at = "<" if raw[1] else ">", memoryview(raw)[_HEAD:], 0

    def number(self, form: str) -> Any:
        size = struct.calcsize(form)
        self._at += -self._at % size
        (value,) = struct.unpack_from(f"{self._order}{form}", self._bytes, self._at)
        self._at += size
        return value

    def stamp_ns(self) -> int:
        return int(self.number("i")) * NS_PER_S + int(self.number("I"))

    def text(self) -> str:
        return bytes(self.data()).rstrip(b"\0").decode()

    def data(self) -> memoryview:
        length = self.number("I")
        if self._at + length > len(self._bytes):
            raise ValueError(f"a field of {length} bytes at {self._at} exceeds them")
        self._at += length
        return self._bytes[self._at - length : self._at]
