"""Find the external weights of an ONNX file and compute the digest that covers them."""

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from ltm_core.base.errors import ModelError
from ltm_core.storage.disk_io import is_file

_LENGTH: Final = rb"([\x80-\xff]?[\x00-\x7f])"
_LOCATION: Final = re.compile(rb"\x6a" + _LENGTH + rb"\x0a\x08location\x12" + _LENGTH)
"""A tensor's entry of external data (`TensorProto.external_data`, key and value) as all exporters write it."""
_ANY_LOCATION: Final = re.compile(rb"\x0a(?:\x08|\x88\x80*\x00)location")


@dataclass(frozen=True)
class NetworkFile:
    """An ONNX file. `weights`: the names of the files with its external weights, relative to its folder, sorted.
    `digest`: the SHA-256 of the file (`sha256sum`), or with external weights that of one line per file, `<sha256>
    <name>`, the ONNX file first with an empty name."""

    content: bytes
    weights: tuple[str, ...]
    digest: str

    @classmethod
    def read(cls, path: Path) -> "NetworkFile":
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
    """Return the names of the external files. Entries in an unusual form are rejected: nothing outside is read."""
    names, odd = set(), len(_ANY_LOCATION.findall(content))
    for match in _LOCATION.finditer(content):
        entry, size = (part[0] if len(part) == 1 else part[0] & 127 | part[1] << 7 for part in match.groups())
        value = content[match.end() : match.end() + size]
        if entry == match.end() - match.end(1) + size and len(value) == size:
            names.add(value.decode("utf-8", "replace"))
            odd -= 1
    if odd:
        raise ModelError(f"{path}: names files with weights in an unusual form; export the network again")
    for name in sorted(names):
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            raise ModelError(f"{path}: its weights are in {name!r}, outside its folder; export the network again")
        if "\0" in name or not is_file(path.parent / name):
            raise ModelError(f"{path}: its weights are in {name!r}, which is missing; put that file beside it")
    return tuple(sorted(names))


_TEXT_ENCODERS = ("text_model.onnx", "text_encoder.onnx", "textual.onnx")  # as hubs name them


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
