"""Find message types by name: Python class, `ros2msg` definition with its dependencies, and type hash."""

import importlib
import importlib.util
import json
import os
import re
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

from ltm_core.base.errors import RecordingError
from ltm_core.storage.disk_io import is_file

_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)")
_PRIMITIVES = {
    *("bool", "byte", "char", "string", "wstring", "float32", "float64"),
    *("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
}
_SEPARATOR = "=" * 80
_OWN = {
    "tf2_msgs/msg/TFMessage": (
        "geometry_msgs/TransformStamped[] transforms\n",
        "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    )
}
"""Definition and type hash of types that are written although their package has no wheel. Source: geometry2."""


def split_type_name(type_name: str) -> tuple[str, str]:
    """Return (package, message) of `package/msg/Message`. Raises RecordingError for another form."""
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise RecordingError(f"{type_name!r} is not a message type name; expected the form package/msg/Message")
    return match[1], match[2]


def type_name_of(msg: Any) -> str:
    """Return the type name of a message object, such as sensor_msgs/msg/Image."""
    cls = type(msg)
    return f"{cls.__module__.partition('.')[0]}/msg/{cls.__name__}"


@lru_cache
def message_class(type_name: str) -> Any:
    """Return the Python class of a message type.

    A bag is untrusted, and imports run code: so only packages that install a definition of this very message are
    imported. Raises RecordingError if the name is malformed or its package is not installed."""
    package, message = split_type_name(type_name)
    if _installed_file(package, f"{message}.msg") is None:
        package = f"ros-jazzy-{package.replace('_', '-')}"
        raise RecordingError(f"message type {type_name} is not installed here; install {package} (pip or apt)")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), message)
    except (ImportError, AttributeError) as error:
        raise RecordingError(f"message type {type_name} is installed but cannot be imported: {error}") from error


@lru_cache
def schema_text(type_name: str) -> str:
    """Return the `ros2msg` schema of a type: its definition, then each dependency after a line and `MSG: pkg/Name`.

    Raises RecordingError for a type whose package is not installed."""
    parts, names = list[str](), [type_name]
    for name in names:  # which grows
        text = _definition(name)
        parts.append(f"{_SEPARATOR}\nMSG: {'/'.join(split_type_name(name))}\n{text}" if parts else text)
        names += dict.fromkeys(one for one in _dependencies(name, text) if one not in names)
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


@lru_cache
def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a type (REP-2011), or an empty string if its package has none."""
    package, message = split_type_name(type_name)
    path = _installed_file(package, f"{message}.json")
    if path is None:
        return _OWN[type_name][1] if type_name in _OWN else ""
    hashes = {entry["type_name"]: entry["hash_string"] for entry in json.loads(path.read_text())["type_hashes"]}
    return str(hashes.get(type_name, ""))


def _definition(type_name: str) -> str:
    package, message = split_type_name(type_name)
    path = _installed_file(package, f"{message}.msg")
    if path is not None:
        return path.read_text(encoding="utf-8")
    if type_name in _OWN:
        return _OWN[type_name][0]
    place = os.environ.get("AMENT_PREFIX_PATH", "(AMENT_PREFIX_PATH not set)")
    raise RecordingError(f"no definition of message type {type_name} in {place} or {sys.prefix}; install its package")


def _dependencies(type_name: str, text: str) -> list[str]:
    package, _ = split_type_name(type_name)
    found = []
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if len(words) < 2:
            continue
        base = re.split(r"[\[<]", words[0], maxsplit=1)[0]  # cut array and string bounds off
        if base in _PRIMITIVES:
            continue
        owner, _, message = base.rpartition("/")
        found.append(f"{owner.removesuffix('/msg') or package}/msg/{message}")
    return found


def _installed_file(package: str, name: str) -> Path | None:
    """Return `share/<package>/msg/<name>` under an ament prefix, or above the Python package (the wheels)."""
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    spec = importlib.util.find_spec(package)
    if spec is not None and spec.origin is not None:
        prefixes += Path(spec.origin).parents
    return next(filter(is_file, (prefix / "share" / package / "msg" / name for prefix in prefixes)), None)
