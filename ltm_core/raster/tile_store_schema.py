"""Schema of a tile store, the records of a transaction, and the serialisation of arrays."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import ceil, prod
from typing import Any

import numpy as np
import zstandard
from numpy.typing import DTypeLike, NDArray

from ltm_core.errors import ConfigError
from ltm_core.grid import GridGeometry

Key = tuple[int, int]
"""(row, col) of a tile, counted in tiles from the grid's north-west corner."""
Tile = dict[str, NDArray[Any]]

_LEVEL = 1
_RENAMED = {
    "witnesses": "camera_hashes",
    "sheet_variance": "relative_variance",
    "c_sheet_variance": "c_relative_variance",
}
"""Fields by the names that stores of version 0.1 know them by; a field's place in a tile's bytes is not by name."""
_CHANGE = np.dtype([("row", "<i4"), ("col", "<i4"), ("old", "<i4"), ("new", "<i4")])


@dataclass(frozen=True)
class Field:
    """One array of every tile: `shape` is that of one cell's value, () a scalar."""

    dtype: DTypeLike
    shape: tuple[int, ...] = ()

    @property
    def stored(self) -> np.dtype[Any]:
        """The dtype in the file: little-endian."""
        return np.dtype(self.dtype).newbyteorder("<")


@dataclass(frozen=True)
class StoreSchema:
    """`kind`, `version`: of the content (`fuel`, 1). `geometry`: in the site's CRS. `tile`: cells a side. `terms`: what
    else the meaning of the numbers depends on, such as constants that went into them.
    """

    kind: str
    version: int
    geometry: GridGeometry
    tile: int
    fields: Mapping[str, Field]
    terms: str = ""

    def __post_init__(self) -> None:
        if self.tile < 1 or not self.fields:
            raise ConfigError(f"a tile store needs tiles of a cell or more and a field, got {self.tile}, {self.fields}")

    @property
    def tiles(self) -> tuple[int, int]:
        """Rows and columns of tiles that cover the grid; those at its south and east edges reach over it."""
        return ceil(self.geometry.height / self.tile), ceil(self.geometry.width / self.tile)

    def described(self) -> str:
        """The schema as the JSON text that the file holds."""
        return json.dumps(
            {
                "kind": self.kind,
                "version": self.version,
                "geometry": asdict(self.geometry),
                "tile": self.tile,
                "fields": {name: [f.stored.str, list(f.shape)] for name, f in self.fields.items()},
                "terms": self.terms,
            }
        )

    @classmethod
    def from_description(cls, text: str, place: str) -> StoreSchema:
        """The inverse of `described`. Raises ConfigError on any other text, which stands in `place`."""
        try:
            content = json.loads(text)
            return cls(
                str(content["kind"]),
                int(content["version"]),
                GridGeometry(**content["geometry"]),
                int(content["tile"]),
                {
                    _RENAMED.get(name, name): Field(np.dtype(dtype), tuple(shape))
                    for name, (dtype, shape) in content["fields"].items()
                },
                str(content["terms"]),
            )
        except (ValueError, KeyError, TypeError) as error:
            raise ConfigError(f"{place}: its description cannot be read: {text[:120]!r} ({error})") from error

    def differences(self, other: StoreSchema) -> str:
        """What `other` has otherwise; empty where both are the same."""
        mine, theirs = (json.loads(schema.described()) for schema in (self, other))
        return "; ".join(f"{key} is {theirs[key]}, here {mine[key]}" for key in mine if theirs[key] != mine[key])

    def pack(self, key: Key, arrays: Mapping[str, NDArray[Any]]) -> bytes:
        """A tile as compressed bytes with a checksum. Raises ValueError on arrays that are not this schema's."""
        across = self.tiles
        if not (0 <= key[0] < across[0] and 0 <= key[1] < across[1]):
            raise ValueError(f"tile {key} is outside a grid of {across} tiles")
        if arrays.keys() != self.fields.keys():
            raise ValueError(f"a tile of {self.kind} has {sorted(self.fields)}, got {sorted(arrays)}")
        parts = []
        for name, spec in self.fields.items():
            array, shape = arrays[name], (self.tile, self.tile, *spec.shape)
            if array.shape != shape or array.dtype.newbyteorder("<") != spec.stored:
                raise ValueError(
                    f"field {name} of a tile is {array.shape} {array.dtype}, must be {shape} {spec.stored}"
                )
            parts.append(np.ascontiguousarray(array, spec.stored).tobytes())
        return compressed(b"".join(parts))

    def unpack(self, content: bytes) -> Tile:
        """The inverse of `pack`; the arrays are writable. Raises ConfigError where the bytes are damaged."""
        shapes = {name: (self.tile, self.tile, *spec.shape) for name, spec in self.fields.items()}
        sizes = {name: prod(shapes[name]) * spec.stored.itemsize for name, spec in self.fields.items()}
        whole = decompressed(content, sum(sizes.values()))
        arrays, offset = {}, 0
        for name, spec in self.fields.items():
            part = np.frombuffer(whole, spec.stored, prod(shapes[name]), offset)
            arrays[name] = part.reshape(shapes[name]).astype(np.dtype(spec.dtype).newbyteorder("="))
            offset += sizes[name]
        return arrays


@dataclass(frozen=True)
class FrameRecord:
    """A frame that is counted: once by `source` (its camera) and `stamp_ns`.

    `tiles`, `model`: for the record of who touched which tile with what network. `payload`: what it takes to count the
    frame again; the store keeps it until tiles that hold the frame's effect are committed.
    """

    source: str
    stamp_ns: int
    tiles: Sequence[Key] = ()
    model: str = ""
    payload: bytes = field(default=b"", repr=False)


@dataclass(frozen=True, eq=False)
class CellChanges:
    """Cells of a layer that a frame of `stamp_ns` (or an order of that time) changed, for the journal.

    `rows`, `cols`, `old`, `new`: (N,) integers that fit int32.
    """

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
    def unpack(cls, layer: str, stamp_ns: int, content: bytes) -> CellChanges:
        """Raises ConfigError where the bytes are damaged."""
        table = np.frombuffer(decompressed(content), _CHANGE)
        return cls(layer, stamp_ns, table["row"], table["col"], table["old"], table["new"])


@dataclass(frozen=True)
class Touch:
    """What a source's frames, labelled by one network, did to a tile: how many they are, the first and last stamp."""

    source: str
    model: str
    frames: int
    first_ns: int
    last_ns: int


def compressed(content: bytes) -> bytes:
    """Zstandard with a checksum, so that damage is found when the bytes are read."""
    return zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True, write_content_size=True).compress(content)


def decompressed(content: bytes, size: int | None = None) -> bytes:
    """Raises ConfigError where the bytes are damaged or do not hold `size` bytes."""
    try:
        whole = zstandard.ZstdDecompressor().decompress(content)
    except (zstandard.ZstdError, TypeError) as error:
        raise ConfigError(f"the store's content is damaged ({error}); restore it from a copy") from error
    if size is not None and len(whole) != size:
        raise ConfigError(f"the store's content is damaged: {len(whole)} bytes in place of {size}; restore it")
    return whole
