"""Find the external weights of an ONNX file and compute the digest that covers them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from ltm_core.base.errors import ModelError
from ltm_core.storage.disk_io import is_file

_FIELDS: Final[dict[str, dict[int, str]]] = {
    "model": {7: "graph", 25: "function"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "function": {7: "node"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {13: "entry"},
    "entry": {1: "key", 2: "value"},
}
"""Messages of `onnx.proto` on the way to a tensor's external data, by field number."""


@dataclass(frozen=True)
class NetworkFile:
    """An ONNX file. `weights`: the names of the files with its external weights, relative to its folder, sorted.

    `digest`: the SHA-256 of the file (`sha256sum`), or with external weights that of one line per file, `<sha256>
    <name>`, the ONNX file first with an empty name."""

    content: bytes
    weights: tuple[str, ...]
    digest: str

    @classmethod
    def read(cls, path: Path) -> NetworkFile:
        """Read an ONNX file. A file of another format has no weights; ONNX Runtime rejects it later. Raises ModelError
        if it cannot be read, or if weights are missing or outside its folder."""
        try:
            content = path.read_bytes()
            own = hashlib.sha256(content).hexdigest()
            weights = _weights(path, content)
            if not weights:
                return cls(content, (), own)
            lines = [f"{own} \n", *(f"{file_digest(path.parent / name)} {name}\n" for name in weights)]
        except OSError as reason:
            raise ModelError(f"{path}: cannot be read ({reason}); check the file and its permissions") from reason
        return cls(content, weights, hashlib.sha256("".join(lines).encode()).hexdigest())


def file_digest(path: Path) -> str:
    """Return the SHA-256 of one file as hexadecimal text."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _weights(path: Path, content: bytes) -> tuple[str, ...]:
    try:
        names = sorted(set(_locations(memoryview(content), "model")))
    except (ValueError, IndexError, RecursionError):
        return ()
    for name in names:
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            raise ModelError(f"{path}: its weights are in {name!r}, outside its folder; export the network again")
        if not is_file(path.parent / name):
            raise ModelError(f"{path}: its weights are in {name}, which is missing; put that file beside it")
    return tuple(names)


def _locations(message: memoryview, kind: str) -> Iterator[str]:
    """Yield each external location in a message of this kind. Raises ValueError or IndexError for another format."""
    if kind == "entry":
        entry = {_FIELDS[kind].get(number): bytes(part) for number, part in _parts(message)}
        if entry.get("key") == b"location":
            yield entry.get("value", b"").decode()
        return
    for number, part in _parts(message):
        if (inner := _FIELDS[kind].get(number)) is not None:
            yield from _locations(part, inner)


def _parts(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield number and content of each length-delimited field of a Protocol Buffers message."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        wire = key & 7
        if wire == 0:
            _, at = _varint(message, at)
        elif wire in (1, 5):
            at += 8 if wire == 1 else 4
        elif wire == 2:
            size, at = _varint(message, at)
            if at + size > len(message):
                raise ValueError("field longer than its message")
            yield key >> 3, message[at : at + size]
            at += size
        else:
            raise ValueError(f"wire type {wire}")


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 0x7F) << shift
        shift, at = shift + 7, at + 1
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError("number too long")


_TEXT_ENCODERS = ("text_model.onnx", "text_encoder.onnx", "textual.onnx")
"""Names under which hubs keep the text encoder of a network."""


def network_in(folder: Path) -> Path:
    """Return the ONNX file of a folder as hubs have it. Raises ModelError for none, or several without `model.onnx`."""
    files = [f for f in sorted([*folder.glob("*.onnx"), *folder.glob("onnx/*.onnx")]) if f.name not in _TEXT_ENCODERS]
    usual = [file for file in files if file.name == "model.onnx"] or files
    if len(usual) != 1:
        found = ", ".join(str(file.relative_to(folder)) for file in usual) or "none"
        raise ModelError(f"{folder}: expected one ONNX file, found {found}; give the file")
    return usual[0]


def prompt_files(folders: Iterable[Path]) -> dict[str, str]:
    """Return the `prompts` of a manifest (`PromptSpec`) from the files in these folders; empty without a tokenizer."""
    places = [folder.resolve() for folder in folders]
    names = {"tokenizer": ("tokenizer.json",), "encoder": _TEXT_ENCODERS}
    found = {
        key: str(file)
        for key, options in names.items()
        if (file := next((f for folder in places for name in options if is_file(f := folder / name)), None))
    }
    return found if "tokenizer" in found else {}
