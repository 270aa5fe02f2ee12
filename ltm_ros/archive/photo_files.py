"""Photos that are files of their own, as pictures."""

from __future__ import annotations

from ltm_msgs_py.bag.picture_cdr import CompressedPicture

PHOTOS = (".jpg", ".jpeg", ".png")
"""How their names end, in lower case."""
_PNG = b"\x89PNG"


def photo_picture(data: bytes, stamp_ns: int) -> CompressedPicture:
    """Of the bytes of a JPEG or PNG file, as a message of it would be."""
    return CompressedPicture(stamp_ns, "png" if data.startswith(_PNG) else "jpeg", memoryview(data))
