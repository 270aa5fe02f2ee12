"""What the manifest of a site's confirmed surfaces says: which versions there are, and which of them have counted."""

from __future__ import annotations

import json

import numpy as np
from pydantic import Field, ValidationError, model_validator

from ltm_core.base.errors import StoreError
from ltm_core.base.strict_model import StrictModel

AS_GIVEN = ""
"""In place of a version: nothing is confirmed, the terrain is as its rasters give it."""
VERSION = r"[0-9a-f]{16}"
KEPT = 100
"""Versions whose files are kept: frames of months name the surface that they were traced to."""
FORMAT = 1
"""Format of the manifests that this program reads. A later format must state its number as `format`."""


class SurfaceVersion(StrictModel):
    """One version. `version`: the first 16 digits of `digest`, the SHA-256 of its file. `parent`: the version that it
    followed when it came last. `as_of_ns`: stamp of the newest frame that had a say. `seen`: cells that independent
    views have judged, of the `cells` of the grid; `changed` of them are confirmed as changed, `lowered` with their
    bare earth.
    """

    version: str = Field(pattern=f"^{VERSION}$")
    digest: str = Field(pattern="^[0-9a-f]{64}$")
    parent: str = Field(pattern=f"^({VERSION})?$")
    as_of_ns: int = Field(ge=0)
    cells: int = Field(ge=1)
    seen: int = Field(ge=0)
    changed: int = Field(ge=0)
    lowered: int = Field(ge=0)

    @model_validator(mode="after")
    def _named_by_content(self) -> SurfaceVersion:
        if not self.digest.startswith(self.version):
            raise ValueError(f"version {self.version} does not begin its digest {self.digest}")
        return self

    @property
    def changed_share(self) -> float:
        """Of what independent views have seen."""
        return self.changed / max(1, self.seen)


class CountedVersion(StrictModel):
    """That a version began to count, by frames up to `as_of_ns`."""

    version: str = Field(pattern=f"^{VERSION}$")
    as_of_ns: int = Field(ge=0)


class SurfaceManifest(StrictModel):
    """`current`: the version that counts. `held`: it was taken back, and none follows by itself. `history`: what has
    counted, in order, without what was taken back; a version that returns is there twice. `forgotten`: there was more
    before that.
    """

    site: str
    current: str = Field(AS_GIVEN, pattern=f"^({VERSION})?$")
    held: bool = False
    versions: tuple[SurfaceVersion, ...] = ()
    history: tuple[CountedVersion, ...] = ()
    forgotten: bool = False

    @model_validator(mode="after")
    def _current_is_listed(self) -> SurfaceManifest:
        if self.current and self.entry(self.current) is None:
            raise ValueError(f"current version {self.current} is not among the versions")
        if any(self.entry(one.version) is None for one in self.history):
            raise ValueError("a version of the history is not among the versions")
        if self.current != (self.history[-1].version if self.history else AS_GIVEN):
            raise ValueError(f"current version {self.current!r} is not the last of the history")
        return self

    def entry(self, version: str) -> SurfaceVersion | None:
        """What is known of a version; None where it is not listed."""
        return next((one for one in self.versions if one.version == version), None)

    def at(self, moment_ns: int | None) -> SurfaceVersion | None:
        """The current version, or the one before it that counted at a moment, with the stamp from which on it did;
        None: as given. Raises StoreError for a moment of which nothing is kept any more.
        """
        past = [one for one in self.history if moment_ns is None or one.as_of_ns <= moment_ns]
        if past:
            found = self.entry(past[-1].version)
            return None if found is None else found.model_copy(update={"as_of_ns": past[-1].as_of_ns})
        if self.forgotten and moment_ns is not None:
            kept = "none is kept"
            if self.history:
                since = np.datetime64(self.history[0].as_of_ns, "ns").astype("datetime64[s]")
                kept = f"{KEPT} are kept, the first of {since} UTC; ask for a later moment"
            raise StoreError(
                f"which surface counted then is forgotten: {kept}, or export bare earth as given with a site file "
                "without terrain.trace_confirmed"
            )
        return None


def of_later_release(content: bytes, error: ValidationError) -> str:
    """How a manifest that is none for this program shows that a later one wrote it; empty: it does not, and is damaged.

    It states a later format, or has keys that this program does not know and nothing else is wrong with it.
    """
    try:
        found = json.loads(content)
    except (ValueError, RecursionError):
        return ""
    stated = found.get("format") if isinstance(found, dict) else None
    if isinstance(stated, int) and stated > FORMAT:
        return f"it is of format {stated}, and this release reads {FORMAT}"
    problems = error.errors()
    if any(one["type"] != "extra_forbidden" for one in problems):
        return ""
    return (
        f"it has {', '.join('.'.join(map(str, one['loc'])) for one in problems[:3])}, which this release does not know"
    )
