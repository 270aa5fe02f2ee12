"""Reads and writes areas of photos that a person has named: `polygons.json`, a list of image, class and polygon."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pydantic import ConfigDict, Field

from ltm_core.config_io import checked
from ltm_core.errors import ConfigError
from ltm_core.strict_model import StrictModel
from ltm_core.text_io import read_text
from ltm_core.vision.mask_config import MOST_POINTS, Point

POLYGONS_FILE: Final = "polygons.json"
MASKED: Final = "masked"
"""Class of areas that hide the landscape, for `ltm mask --drawn`; unlabelled in label images."""
ERASED: Final = "unlabelled"
"""Class of areas in which what was drawn before is taken back."""
LARGEST_FILE = 16 << 20
"""Bytes."""
MOST_AREAS = 20_000


class NamedArea(StrictModel):
    """One area of one photo."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, protected_namespaces=(), allow_inf_nan=False, populate_by_name=True
    )

    image: str = Field(max_length=255)
    """File name of the photo."""
    kind: str = Field(alias="class", max_length=80)
    """A class of the label set, `MASKED`, `ERASED`, or what a mask hides: lens, caption, structure."""
    polygon: tuple[Point, ...] = Field(min_length=3, max_length=MOST_POINTS)
    """Corners (u, v) in pixels of the photo."""
    number: int | None = None
    """Of a proposal of `ltm mask`."""
    reason: str = Field("", max_length=400)


class _NamedAreas(StrictModel):
    areas: tuple[NamedArea, ...] = Field(max_length=MOST_AREAS)


def parse_areas(text: str, place: str) -> tuple[NamedArea, ...]:
    """Raises ConfigError: no JSON, another form, values that are no areas; `place` names the text."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{place}: not JSON ({error})") from error
    if not isinstance(content, list):
        raise ConfigError(f"{place}: expected a list of areas (image, class, polygon), got {type(content).__name__}")
    return checked(_NamedAreas, {"areas": content}, place, unnamed=("areas",)).areas


def read_areas(path: Path) -> tuple[NamedArea, ...]:
    """Raises ConfigError, as `parse_areas` and where the file cannot be read."""
    return parse_areas(read_text(path, LARGEST_FILE, ConfigError), str(path))


def write_areas(path: Path, areas: Sequence[NamedArea]) -> None:
    """One line an area; whole, or not at all."""
    lines = [
        json.dumps(area.model_dump(by_alias=True, exclude_defaults=True, mode="json"), ensure_ascii=False)
        for area in areas
    ]
    replace_file(path, ("[\n" + ",\n".join(lines) + "\n]\n").encode())


def replace_file(path: Path, content: bytes) -> None:
    """Write a file whole, or leave what was there. Raises OSError."""
    beside = path.with_name(f".{path.name}.part")
    beside.write_bytes(content)
    beside.replace(path)
