"""Convert label sets, skyline turns and versions of the confirmed surface to JSON topics, and back.

Versions of the confirmed surface <-> std_msgs/String of JSON, and which of them a frame was traced to.

A message names a version, never a file: who takes it looks the version up in the folder that its own site names.
"""

from __future__ import annotations

import json
import re
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from std_msgs.msg import String

from ltm_core.base.errors import MessageError
from ltm_core.surface.confirmed_surface import AS_GIVEN, VERSION, SurfaceManifest
from ltm_core.vision.labels import UNLABELLED, LabelSet


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Label(_Strict):
    id: int = Field(ge=0, lt=UNLABELLED)
    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")
    color: list[int] = Field(min_length=3, max_length=3)
    ground_cover: bool


class _LabelInfo(_Strict):
    unlabelled: int
    labels: list[_Label] = Field(min_length=1)
    model: str = Field("", max_length=200)
    reliability: str = Field("", max_length=200)


def label_set_to_msg(labels: LabelSet, model: str = "", reliability: str = "") -> String:
    """Return the classes, their colours and their part in votes, as JSON; `model`: the network, if known;
    `reliability`: what its labels were measured on."""
    about = {"model": model, "reliability": reliability}
    return String(data=json.dumps(labels.info() | {name: text for name, text in about.items() if text}))


def msg_to_model(msg: Any) -> str:
    """Return the network of a `labels/info` message; empty if not stated. Raises MessageError for another message."""
    return _checked(msg).model


def _checked(msg: Any) -> _LabelInfo:
    try:
        return _LabelInfo.model_validate_json(msg.data)
    except ValidationError as error:
        where = "; ".join(f"{'.'.join(map(str, e['loc'])) or 'document'}: {e['msg']}" for e in error.errors()[:3])
        raise MessageError(f"labels/info is not a label set: {where}; got {msg.data[:120]!r}") from error


_LONGEST = 4096


def manifest_to_msg(manifest: SurfaceManifest) -> String:
    """Return the version in use, its digest and the shares of cells seen and changed."""
    entry = manifest.entry(manifest.current)
    told: dict[str, Any] = {"version": manifest.current, "held": manifest.held}
    if entry is not None:
        told |= entry.model_dump(exclude={"version"}) | {
            "seen_share": round(entry.seen / entry.cells, 4),
            "changed_share": round(entry.changed_share, 4),
        }
    return String(data=json.dumps(told))


def msg_to_version(msg: Any) -> str:
    """Return the version that a message names. Raises MessageError without one."""
    return _version(_parsed(msg, "terrain surface"), "version")


def traced_to_msg(camera: str, stamp_ns: int, version: str) -> String:
    """Return the surface version of a frame. `version`: to which the frame of that stamp was traced; AS_GIVEN: to the
    site's rasters.
    """
    return String(data=json.dumps({"camera": camera, "stamp_ns": stamp_ns, "surface": version}))


def msg_to_traced(msg: Any) -> tuple[int, str]:
    """Return the stamp of the frame, ns, and the version. Raises MessageError if they are missing."""
    told = _parsed(msg, "depth info")
    stamp = told.get("stamp_ns")
    if isinstance(stamp, bool) or not isinstance(stamp, int) or not 0 <= stamp < 2**63:
        raise MessageError(f"depth info has the stamp {stamp!r}; expected whole nanoseconds >= 0")
    return stamp, _version(told, "surface")


def _parsed(msg: Any, what: str) -> dict[str, Any]:
    text = msg.data
    try:
        told = json.loads(text) if len(text) <= _LONGEST else None
    except (ValueError, RecursionError):
        told = None
    if not isinstance(told, dict):
        raise MessageError(f"{what} is not a JSON mapping of at most {_LONGEST} characters: {text[:80]!r}")
    return told


def _version(told: dict[str, Any], key: str) -> str:
    version = told.get(key)
    if version == AS_GIVEN or (isinstance(version, str) and re.fullmatch(VERSION, version, re.ASCII)):
        return version
    raise MessageError(
        f"{key} {str(version)[:80]!r} is not a surface version: expected 16 hexadecimal digits, or nothing"
    )
