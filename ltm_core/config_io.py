"""Reads YAML files into typed configuration; errors name the file, the key and the value."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from ltm_core.errors import ConfigError
from ltm_core.redaction import shown
from ltm_core.yaml_io import line_of, read_yaml

Model = TypeVar("Model", bound=BaseModel)
Keys = tuple[int | str, ...]


def load_yaml(path: Path | str, model: type[Model]) -> Model:
    """Read a YAML mapping into `model`. Raises ConfigError: no file, no YAML, keys unknown or twice, wrong values."""
    path = Path(path)
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected a mapping of keys to values, got {type(content).__name__}")
    return checked(model, content, str(path), line_of=lambda keys: line_of(path, keys))


def checked(
    model: type[Model],
    content: object,
    place: str,
    line_of: Callable[[Keys], int | None] = lambda keys: None,
    unnamed: Collection[str] = (),
) -> Model:
    """`content` as a `model`. Raises ConfigError that lists every wrong key with its value.

    `line_of`: where in the file a key stands. `unnamed`: sections of the model that the file does not write, such as
    those of the columns of a CSV.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        known = ", ".join(model.model_fields)
        lines = []
        for item in error.errors():
            key = ".".join(str(part) for part in item["loc"] if part not in unnamed) or "(all)"
            line = line_of(item["loc"])
            at = "" if line is None else f", line {line}"
            if item["type"] == "extra_forbidden":
                lines.append(f"  {key}: unknown key{at}" + (f"; known are {known}" if len(item["loc"]) == 1 else ""))
            elif item["type"] == "missing":
                lines.append(f"  {key}: missing")
            else:
                lines.append(f"  {key}: {item['msg']} (got {shown(item['input'], item['loc'])}{at})")
        raise ConfigError("\n".join([f"{place}:", *lines])) from error
