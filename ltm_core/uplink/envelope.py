"""Messages between towers, their region's map and its subscribers: header, body and signature.

    magic (4 bytes) | header, certificate: uint16 length; body: uint32 length | header | certificate | body | signature

Integers are big-endian, the header is JSON, the certificate X.509 DER. The lengths are checked against the whole before
anything is decoded. The signature is over all before it, so that neither a broker nor a file in between can change what
a tower has said."""

import struct
from dataclasses import dataclass, field
from typing import Final, TypeVar

from pydantic import Field, ValidationError

from ltm_core.base.errors import MessageError
from ltm_core.base.strict_model import StrictModel, problem_text
from ltm_core.geometry.grid import GridGeometry

VERSION: Final = 1
"""Version of the headers and bodies; others are rejected with an explanation."""
MAGIC: Final = b"LTMR"
LARGEST: Final = 96 << 10
"""Maximum bytes of an envelope: votes have at most 64 kB, a header 4 kB, a certificate 2 kB."""
LARGEST_HEADER: Final = 4 << 10
LARGEST_CERTIFICATE: Final = 4 << 10
LARGEST_SIGNATURE: Final = 256
_LENGTHS: Final = struct.Struct(">4sHHI")
MOST_OUTCOMES: Final = 64
"""Maximum number of outcomes in an acknowledgement."""
LONGEST_REASON: Final = 300
"""Maximum characters of the reason for a rejection. They must be printable, so that `MOST_OUTCOMES` of them fit an
envelope."""
NAME: Final = r"^[a-z][a-z0-9_]{0,62}$"
"""Pattern of the names of regions, towers and cameras: they are parts of topics, and a certificate's common name has at
most 64 characters."""


@dataclass(frozen=True)
class Envelope:
    """Envelope of a message. `signed`: the signed bytes. Only the lengths have been checked."""

    header: bytes
    certificate: bytes = field(repr=False)
    body: bytes = field(repr=False)
    signature: bytes = field(repr=False)
    signed: bytes = field(repr=False)


def packed(header: bytes, certificate: bytes, body: bytes) -> bytes:
    """Return the bytes to sign; the signature follows them. Raises MessageError if they are too large."""
    size = _LENGTHS.size + len(header) + len(certificate) + len(body) + LARGEST_SIGNATURE
    if len(header) > LARGEST_HEADER or len(certificate) > LARGEST_CERTIFICATE or size > LARGEST:
        raise MessageError(
            f"a header of {len(header)}, a certificate of {len(certificate)} and a body of {len(body)} bytes "
            f"exceed the envelope limit of {LARGEST}"
        )
    lengths = _LENGTHS.pack(MAGIC, len(header), len(certificate), len(body))
    return lengths + header + certificate + body


def unpacked(content: bytes) -> Envelope:
    """Parse the parts of an envelope. Raises MessageError on anything else."""
    if not _LENGTHS.size <= len(content) <= LARGEST:
        raise MessageError(f"an envelope has {_LENGTHS.size} to {LARGEST} bytes, this has {len(content)}")
    magic, header, certificate, body = _LENGTHS.unpack_from(content)
    end = _LENGTHS.size + header + certificate + body
    if magic != MAGIC or header > LARGEST_HEADER or certificate > LARGEST_CERTIFICATE:
        raise MessageError(f"not an envelope: it begins with {content[: _LENGTHS.size]!r}")
    if not 0 < len(content) - end <= LARGEST_SIGNATURE:
        raise MessageError(f"an envelope states {end} bytes and a signature, it has {len(content)}")
    first, second = _LENGTHS.size + header, end - body
    parts = content[_LENGTHS.size : first], content[first:second], content[second:end]
    return Envelope(*parts, content[end:], content[:end])


class VotesGrid(StrictModel):
    """The fuel grid that votes are on. `origin`: (x, y) of the map frame in `crs`; the edges are those in `crs`."""

    crs: str = Field(pattern=r"^[A-Z]{4,8}:[0-9]{3,6}$")
    """CRS as an authority code such as EPSG:32611; other forms from the network are not parsed."""
    origin: tuple[float, float]
    x_min: float
    y_max: float
    resolution: float = Field(gt=0)
    width: int = Field(ge=1, le=1 << 20)
    height: int = Field(ge=1, le=1 << 20)

    @classmethod
    def of(cls, geometry: GridGeometry, origin: tuple[float, float]) -> "VotesGrid":
        """Return the grid of `geometry`, in its CRS."""
        edges = {name: getattr(geometry, name) for name in ("x_min", "y_max", "resolution", "width", "height")}
        return cls(crs=str(geometry.crs), origin=origin, **edges)

    @property
    def geometry(self) -> GridGeometry:
        """Return the geometry in its CRS."""
        return GridGeometry(self.x_min, self.y_max, self.resolution, self.width, self.height, self.crs)

    @property
    def in_map(self) -> GridGeometry:
        """Return the geometry in the map frame of the votes' points."""
        return self.geometry.translated(-self.origin[0], -self.origin[1])


class AckHeader(StrictModel):
    """Acknowledgement of frames of one tower by the aggregator; the body is `Outcomes` as JSON."""

    version: int = VERSION
    region: str = Field(pattern=NAME)
    tower: str = Field(pattern=NAME)


class _FrameHeader(AckHeader):
    camera: str = Field(pattern=NAME)
    stamp_ns: int = Field(ge=0, lt=1 << 63)


class HeaderStart(_FrameHeader):
    """Common part of all versions of a tower's header, so that newer ones can be answered."""

    model_config = StrictModel.model_config | {"extra": "ignore"}

    version: int


class VotesHeader(_FrameHeader):
    """Header of a frame's votes; the body is the serialised message (CDR of sensor_msgs/PointCloud2)."""

    model: str = Field(max_length=200)
    """Name of the model that made the labels; empty: unknown."""
    grid: VotesGrid


class Outcome(StrictModel):
    """Result for a frame. `done`: it need not be sent again; else `why` is the reason."""

    camera: str = Field(max_length=63)
    stamp_ns: int
    done: bool
    why: str = Field("", max_length=LONGEST_REASON)


class Outcomes(StrictModel):
    outcomes: list[Outcome] = Field(max_length=MOST_OUTCOMES)


HeaderT = TypeVar("HeaderT", bound=StrictModel)


def header_of(kind: type[HeaderT], envelope: Envelope) -> HeaderT:
    """Parse a header. Raises MessageError if it is invalid or of another kind."""
    return _parsed(kind, envelope.header, "header")


def outcomes_of(envelope: Envelope) -> list[Outcome]:
    """Return the outcomes of an acknowledgement. Raises MessageError on an invalid body."""
    return _parsed(Outcomes, envelope.body, "body").outcomes


def _parsed(kind: type[HeaderT], content: bytes, what: str) -> HeaderT:
    try:
        return kind.model_validate_json(content)
    except ValidationError as error:
        raise MessageError(f"invalid {what} of an envelope: {problem_text(error)}") from error
