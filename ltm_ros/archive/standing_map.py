"""Whether the map that is there is the one that a run would make again: then nothing is left to do.

A run's record says of what its map was made and which files were published; it is taken away before any of them is
written over, and comes last.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from ltm_core.errors import ArchiveError
from ltm_core.fuel.burns_io import Burn
from ltm_core.resources import config_path
from ltm_core.site import Site
from ltm_ros.archive.content_digest import (
    burns_digest,
    digest,
    evidence_digest,
    file_digest,
    map_code_digest,
    map_settings,
)
from ltm_ros.archive.publish import RUN, sha256_of
from ltm_ros.archive.results import ResultFolder


def map_digest(
    site: Site, files: Sequence[str], burns: Sequence[Burn], terrain: bool, allowed: Sequence[object]
) -> str:
    """Of all that a map and what is written of it hang on. Raises LtmError for files of the site that are not there.

    Args:
        files: results of the tasks, whose names tell what they hold, in the order of the plan.
        allowed: the share that may fail, and what has failed until then.
    """
    burned = burns_digest(burns)
    shipped = file_digest(config_path("fuel")), file_digest(config_path(site.labels))
    return digest(
        map_code_digest(),
        map_settings(site),
        evidence_digest(site),
        shipped,
        list(files),
        burned,
        terrain,
        list(allowed),
    )


def standing_record(results: ResultFolder, made_of: str) -> dict[str, Any] | None:
    """The record of the run that made just this map, if all of it is there: its stores by their content, and by name
    what people read."""
    try:
        record = json.loads(results.read(RUN)) if results.has(RUN) else {}
        if record.get("made_of") != made_of:
            return None
        stores: dict[str, str] = record["stores"]
        files = set(record["files"])
        for name, expected in stores.items():
            if not results.has(name):
                return None
            with results.open(name) as file:
                if sha256_of(file) != expected:
                    return None
        folders = {name.rpartition("/")[0] for name in files}
        there = {f"{folder}/{name}".lstrip("/") for folder in folders for name in results.names(folder)}
        named = sum(failure["count"] for failure in record["failures"])
        return record if files <= there and named == record["frames"]["failed"] else None
    except (ValueError, LookupError, TypeError, ArchiveError):  # of another version, or spoiled: the map is made again
        return None
