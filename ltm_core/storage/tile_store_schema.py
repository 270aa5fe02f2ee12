"""Schema of a tile store, the records of a transaction, and the serialisation of arrays."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from math import ceil, prod
from typing import Annotated, Any

import numpy as np
import zstandard
from numpy.typing import DTypeLike, NDArray
from pydantic import Field as NumberField
from pydantic import ValidationError

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import StrictModel, problem_text
from ltm_core.geometry.grid import GridGeometry

Key = tuple[int, int]
"""(row, col) of a tile, counted in tiles from the grid's north-west corner."""
Tile = dict[str, NDArray[Any]]

LARGEST_TILE = 64 << 20
"""Maximum bytes of a tile; those of our maps have one or two million."""
_LEVEL = 1
_CHANGE = np.dtype([("row", "<i4"), ("col", "<i4"), ("old", "<i4"), ("new", "<i4")])


@dataclass(frozen=True)
class Field:
    """One array of every tile: `shape` is that of one cell's value, () a scalar."""

    dtype: DTypeLike
    shape: tuple[int, ...] = ()

    @property
    def stored(self) -> np.dtype[Any]:
        """Return the dtype in the file: little-endian."""
        return np.dtype(self.dtype).newbyteorder("<")


class _Description(StrictModel):
    """The JSON of a schema."""

    kind: str
    version: int
    geometry: GridGeometry
    tile: int = NumberField(ge=1, le=1024)
    fields: dict[
        str,
        tuple[
            Annotated[str, NumberField(pattern=r"^[<|][bfiu][1248]$")],
            Annotated[list[Annotated[int, NumberField(ge=1, le=256)]], NumberField(max_length=4)],
        ],
    ] = NumberField(min_length=1, max_length=256)
    terms: str


@dataclass(frozen=True)
class StoreSchema:
    """`kind`, `version`: of the content (`fuel`, 1). `geometry`: in the site's CRS. `tile`: cells a side. `terms`: what
    else the meaning of the numbers depends on, such as constants that went into them."""

    kind: str
    version: int
    geometry: GridGeometry
    tile: int
    fields: Mapping[str, Field]
    terms: str = ""

    @property
    def tiles(self) -> tuple[int, int]:
        """Return the rows and columns of tiles that cover the grid; those at its south and east edges reach over it."""
        return ceil(self.geometry.height / self.tile), ceil(self.geometry.width / self.tile)

    def described(self) -> str:
        """Return the schema as the JSON text that the file holds."""
        fields = {name: [f.stored.str, list(f.shape)] for name, f in self.fields.items()}
        content = {"kind": self.kind, "version": self.version, "geometry": asdict(self.geometry), "tile": self.tile}
        return json.dumps(content | {"fields": fields, "terms": self.terms})

    @classmethod
    def from_description(cls, text: str, place: str) -> "StoreSchema":
        """Return the schema from `described`. Raises ConfigError on any other text; `place` is its place."""
        try:
            content = _Description.model_validate_json(text)
        except ValidationError as error:
            found = f"{text[:120]!r} ({problem_text(error)})"
            raise ConfigError(f"{place}: its description cannot be read: {found}; restore it from a copy") from error
        fields = {name: Field(np.dtype(dtype), tuple(shape)) for name, (dtype, shape) in content.fields.items()}
        geometry = GridGeometry(**asdict(content.geometry))
        schema = cls(content.kind, content.version, geometry, content.tile, fields, content.terms)
        size = schema.tile**2 * sum(f.stored.itemsize * prod(f.shape) for f in schema.fields.values())
        if size > LARGEST_TILE:
            raise ConfigError(f"{place}: its description states tiles of {size} bytes; the limit is {LARGEST_TILE}")
        return schema

    def differences(self, other: "StoreSchema") -> str:
        """Return the differences of `other`; empty if both are the same."""
        mine, theirs = (json.loads(schema.described()) for schema in (self, other))
        return "; ".join(f"{key} is {theirs[key]}, here {mine[key]}" for key in mine if theirs[key] != mine[key])

    @cached_property
    def _layout(self) -> np.dtype[Any]:
        """All arrays of a tile, one after the other."""
        side = (self.tile, self.tile)
        return np.dtype([(name, spec.stored, side + spec.shape) for name, spec in self.fields.items()])

    def pack(self, key: Key, arrays: Mapping[str, NDArray[Any]]) -> bytes:
        """Return a tile as compressed bytes with a checksum. Raises ValueError for arrays that do not fit the
        schema."""
        across = self.tiles
        if not (0 <= key[0] < across[0] and 0 <= key[1] < across[1]):
            raise ValueError(f"tile {key} is outside a grid of {across} tiles")
        if arrays.keys() != self.fields.keys():
            raise ValueError(f"a tile of {self.kind} has {sorted(self.fields)}, got {sorted(arrays)}")
        whole = np.empty((), self._layout)
        for name, array in arrays.items():
            wanted = self._layout[name]
            if (array.dtype.newbyteorder("<"), array.shape) != (wanted.base, wanted.shape):
                raise ValueError(f"field {name} of a tile is {array.shape} {array.dtype}, must be {wanted}")
            whole[name] = array
        return compressed(whole.tobytes())

    def unpack(self, content: bytes) -> Tile:
        """Return the arrays of packed bytes; they are writable. Raises ConfigError for damaged bytes."""
        size = self._layout.itemsize
        whole = decompressed(content, size)
        if len(whole) != size:
            raise ConfigError(f"the store's content is damaged: {len(whole)} bytes instead of {size}; restore it")
        tile = np.frombuffer(whole, self._layout)[0]
        return {name: tile[name].astype(np.dtype(spec.dtype).newbyteorder("=")) for name, spec in self.fields.items()}


@dataclass(frozen=True)
class FrameRecord:
    """Counted frame: once by `source` (its camera) and `stamp_ns`.

    `tiles`, `model`: for the record of who touched which tile with what network. `payload`: what it takes to count the
    frame again; the store keeps it until tiles that hold the frame's effect are committed."""

    source: str
    stamp_ns: int
    tiles: Sequence[Key] = ()
    model: str = ""
    payload: bytes = field(default=b"", repr=False)


@dataclass(frozen=True, eq=False)
class CellChanges:
    """Cells of a layer that a frame of `stamp_ns` (or a command of that time) changed, for the journal.

    `rows`, `cols`, `old`, `new`: (N,) integers that fit int32."""

    layer: str
    stamp_ns: int
    rows: NDArray[Any]
    cols: NDArray[Any]
    old: NDArray[Any]
    new: NDArray[Any]

    def pack(self) -> bytes:
        table = np.empty(len(self.rows), _CHANGE)
        for name, column in (("row", self.rows), ("col", self.cols), ("old", self.old), ("new", self.new)):
            table[name] = column
        return compressed(table.tobytes())

    @classmethod
    def unpack(cls, layer: str, stamp_ns: int, content: bytes, shape: tuple[int, int]) -> "CellChanges":
        """Return the changes from bytes; `shape`: of the grid. Raises ConfigError for damaged bytes or cells outside
        the grid."""
        whole = decompressed(content, prod(shape) * _CHANGE.itemsize)
        if len(whole) % _CHANGE.itemsize:
            raise ConfigError(f"the store's journal is damaged: {len(whole)} bytes cannot be decoded; restore it")
        table = np.frombuffer(whole, _CHANGE)
        for name, count in zip(("row", "col"), shape, strict=True):
            if len(table) and not (table[name].min() >= 0 and table[name].max() < count):
                raise ConfigError(f"the store's journal is damaged: a {name} is not below {count}; restore it")
        return cls(layer, stamp_ns, table["row"], table["col"], table["old"], table["new"])


@dataclass(frozen=True)
class Touch:
    """Effect of a source's frames, labelled by one network, on a tile: their number, the first and last stamp."""

    source: str
    model: str
    frames: int
    first_ns: int
    last_ns: int


def compressed(content: bytes) -> bytes:
    """Compress with Zstandard and a checksum, so that damage is detected on reading."""
    return zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True, write_content_size=True).compress(content)


def decompressed(content: bytes, most: int) -> bytes:
    """Decompress. Raises ConfigError for damaged bytes, or if they state more than `most`."""
    try:
        # The library allocates the size that a frame states before it reads the content, whatever bound is given.
        stated = zstandard.frame_content_size(content)
        if not 0 <= stated <= most:
            raise ConfigError(
                f"the store's content is damaged: it states {stated} bytes, the limit is {most}; restore it"
            )
        return zstandard.ZstdDecompressor().decompress(content, max_output_size=most)
    except zstandard.ZstdError as error:
        raise ConfigError(f"the store's content is damaged ({error}); restore it from a copy") from error
