"""The areas that a person named in the photos of a folder (`polygons_io`), checked, photo by photo."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from ltm_core.base.errors import RecordingError
from ltm_core.vision.areas import ERASED, MASKED, NamedArea, read_areas
from ltm_core.vision.labels import LabelSet

_NO_CLASS: Final = (ERASED, MASKED, "lens", "caption", "structure")
"""Areas that take truth away: nothing is known there, or `ltm mask` hides it."""


def read_polygons(path: Path, labels: LabelSet) -> dict[str, list[NamedArea]]:
    """The areas of each photo, in the order of the file.

    Raises ConfigError as `read_areas`; RecordingError for an unknown class, and a photo that is in another folder.
    """
    named: dict[str, list[NamedArea]] = {}
    for place, area in enumerate(read_areas(path)):
        if area.kind not in labels.names and area.kind not in _NO_CLASS:
            known = ", ".join((*labels.names, *_NO_CLASS))
            raise RecordingError(f"{path}: area {place} is of class {area.kind!r}; classes: {known}")
        if Path(area.image).name != area.image or not area.image.isprintable():
            raise RecordingError(
                f"{path}: area {place}: image is {area.image!r}, expected the name of a file beside it"
            )
        named.setdefault(area.image, []).append(area)
    return named
