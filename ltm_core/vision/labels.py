"""Label taxonomy: the meaning and colour of the ids in a label image, and which count as ground cover.

Ids travel in label images and bags, so the seven built-in ones are fixed here; `config/labels.yaml` gives their
colours and their part in fuel votes, and may append further classes."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field

from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray
from ltm_core.storage.config_io import load_yaml

UNLABELLED: Final = 255


class Label(IntEnum):
    """Ids of the built-in classes."""

    SKY = 0
    GRASS = 1
    SHRUB = 2
    TREE = 3
    BARE = 4  # rock, soil, road
    WATER = 5
    BUILT = 6


_Channel = Annotated[int, Field(ge=0, le=255)]


class _LabelEntry(StrictModel):
    id: int = Field(ge=0, lt=UNLABELLED)
    color: tuple[_Channel, _Channel, _Channel]
    ground_cover: bool


class _LabelFile(StrictModel):
    labels: dict[str, _LabelEntry]


@dataclass(frozen=True)
class LabelSet:
    """The classes of label images; position in each tuple is the id. `colors` are sRGB 0..255. `ground_cover` tells
    whether a pixel of the class is evidence of what covers the ground (and so votes in fuel cells). Id 255
    (`UNLABELLED`) is no class: nothing is known of the pixel."""

    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]
    ground_cover: tuple[bool, ...]

    @classmethod
    def load(cls, path: Path | None = None) -> "LabelSet":
        """Read a label file, by default the `labels.yaml` that ships with the system. Raises ConfigError: unknown or
        missing keys, ids with gaps, a built-in class that is absent or renumbered."""
        path = config_path("labels.yaml") if path is None else path
        entries = load_yaml(path, _LabelFile).labels
        by_id = sorted(entries.items(), key=lambda item: item[1].id)
        ids = [entry.id for _, entry in by_id]
        if ids != list(range(len(ids))):
            raise ConfigError(f"{path}: label ids are {ids}, expected each of 0..{len(ids) - 1} once")
        for label in Label:
            name = label.name.lower()
            id_found = entries[name].id if name in entries else "no such label"
            if id_found != label.value:
                raise ConfigError(
                    f"{path}: labels.{name}.id: found {id_found}, expected {label.value}; built-in ids are fixed, "
                    "recorded label images use them (append classes of your own after them)"
                )
        names, found = zip(*by_id, strict=True)
        return cls(names, tuple(entry.color for entry in found), tuple(entry.ground_cover for entry in found))

    def __len__(self) -> int:
        return len(self.names)

    def id_of(self, name: str) -> int:
        """Return the id of a class name; `unlabelled` gives 255. Raises ConfigError for a name that is no class."""
        if name == "unlabelled":
            return UNLABELLED
        if name not in self.names:
            raise ConfigError(f"no label {name!r}; labels: {', '.join(self.names)}, unlabelled")
        return self.names.index(name)

    def name_of(self, label: int) -> str:
        """Return the class name of an id; `unlabelled` for any id that is no class."""
        return self.names[label] if 0 <= label < len(self.names) else "unlabelled"

    @cached_property
    def votes_table(self) -> BoolArray:
        """Return (256,) bool: True for ids whose pixels vote for ground cover."""
        table = np.zeros(256, dtype=np.bool_)
        table[: len(self.ground_cover)] = self.ground_cover
        return table

    def info(self) -> dict[str, Any]:
        """Return the palette as JSON-ready values, for the latched topic `labels/info` and for reports."""
        classes = enumerate(zip(self.names, self.colors, self.ground_cover, strict=True))
        labels = [{"id": n, "name": name, "color": list(color), "ground_cover": c} for n, (name, color, c) in classes]
        return {"unlabelled": UNLABELLED, "labels": labels}
