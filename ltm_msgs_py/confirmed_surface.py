"""Versions of the confirmed surface <-> std_msgs/String of JSON, and which of them a frame was traced to.

A message names a version, never a file: who takes it looks the version up in the folder that its own site names.
"""

from __future__ import annotations

import json
import re
from typing import Any

from std_msgs.msg import String

from ltm_core.base.errors import MessageError
from ltm_core.surface.surface_manifest import AS_GIVEN, SurfaceManifest
from ltm_core.surface.surface_versions_io import VERSION

_LONGEST = 4096


def manifest_to_msg(manifest: SurfaceManifest) -> String:
    """The version that counts, its digest and the shares of cells seen and changed."""
    entry = manifest.entry(manifest.current)
    told: dict[str, Any] = {"version": manifest.current, "held": manifest.held}
    if entry is not None:
        told |= entry.model_dump(exclude={"version"}) | {
            "seen_share": round(entry.seen / entry.cells, 4),
            "changed_share": round(entry.changed_share, 4),
        }
    return String(data=json.dumps(told))


def msg_to_version(msg: Any) -> str:
    """The version that a message names. Raises MessageError where it names none."""
    return _version(_parsed(msg, "terrain surface"), "version")


def traced_to_msg(camera: str, stamp_ns: int, version: str) -> String:
    """`version`: to which the frame of that stamp was traced; AS_GIVEN: to the site's rasters."""
    return String(data=json.dumps({"camera": camera, "stamp_ns": stamp_ns, "surface": version}))


def msg_to_traced(msg: Any) -> tuple[int, str]:
    """Stamp of the frame, ns, and version. Raises MessageError where it has no such thing."""
    told = _parsed(msg, "depth info")
    stamp = told.get("stamp_ns")
    if isinstance(stamp, bool) or not isinstance(stamp, int) or not 0 <= stamp < 2**63:
        raise MessageError(f"depth info has the stamp {stamp!r}; whole nanoseconds from 0 on are right")
    return stamp, _version(told, "surface")


def _parsed(msg: Any, what: str) -> dict[str, Any]:
    text = msg.data
    try:
        told = json.loads(text) if len(text) <= _LONGEST else None
    except (ValueError, RecursionError):
        told = None
    if not isinstance(told, dict):
        raise MessageError(f"{what} is no JSON mapping of at most {_LONGEST} characters: {text[:80]!r}")
    return told


def _version(told: dict[str, Any], key: str) -> str:
    version = told.get(key)
    if version == AS_GIVEN or (isinstance(version, str) and re.fullmatch(VERSION, version, re.ASCII)):
        return version
    raise MessageError(f"{key} {str(version)[:80]!r} is no version of a surface: 16 hexadecimal digits, or nothing")
