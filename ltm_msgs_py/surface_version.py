"""Convert versions of the confirmed surface, and which of them a frame was traced to, to a status and back."""

from __future__ import annotations

import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray

from ltm_core.base.errors import MessageError
from ltm_core.surface.confirmed_surface import AS_GIVEN, VERSION, SurfaceManifest
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.status import msg_to_values, status_to_msg


def manifest_to_msg(manifest: SurfaceManifest) -> DiagnosticArray:
    """Return the version in use, its digest and the shares of cells seen and changed."""
    entry = manifest.entry(manifest.current)
    values: dict[str, object] = {"version": manifest.current, "held": manifest.held}
    if entry is not None:
        values |= entry.model_dump(exclude={"version"}) | {
            "seen_share": round(entry.seen / entry.cells, 4),
            "changed_share": round(entry.changed_share, 4),
        }
    return status_to_msg("terrain/surface", 0 if entry is None else entry.as_of_ns, values)


def msg_to_version(msg: Any) -> str:
    """Return the version that a message names; never a file: who takes it looks it up in its own site's folder. Raises
    MessageError without one."""
    version = msg_to_values(msg).get("version")
    if version == AS_GIVEN or (version is not None and re.fullmatch(VERSION, version, re.ASCII)):
        return version
    raise MessageError(
        f"version {str(version)[:80]!r} is not a surface version: expected 16 hexadecimal digits, or nothing"
    )


def traced_to_msg(camera: str, stamp_ns: int, version: str) -> DiagnosticArray:
    """Return the version to which the frame of a stamp was traced; AS_GIVEN: to the site's rasters."""
    return status_to_msg(f"{camera}/depth", stamp_ns, {"version": version})


def msg_to_traced(msg: Any) -> tuple[int, str]:
    """Return the stamp of the frame, ns, and the version. Raises MessageError if they are missing."""
    return stamp_of(msg), msg_to_version(msg)
