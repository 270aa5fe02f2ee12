"""Reads YAML files into typed configuration; errors name the file, the key and the value."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from ltm_core.errors import ConfigError
from ltm_core.yaml_io import read_yaml

Model = TypeVar("Model", bound=BaseModel)


def load_yaml(path: Path | str, model: type[Model]) -> Model:
    """Read a YAML mapping into `model`. Raises ConfigError: no file, no YAML, keys unknown or twice, wrong values."""
    path = Path(path)
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected a mapping of keys to values, got {type(content).__name__}")
    return checked(model, content, str(path))


def checked(model: type[Model], content: object, place: str) -> Model:
    """`content` as a `model`. Raises ConfigError that lists every wrong key with its value."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        known = ", ".join(model.model_fields)
        lines = []
        for item in error.errors():
            key = ".".join(map(str, item["loc"])) or "(all)"
            if item["type"] == "extra_forbidden":
                lines.append(f"  {key}: unknown key" + (f"; known are {known}" if len(item["loc"]) == 1 else ""))
            elif item["type"] == "missing":
                lines.append(f"  {key}: missing")
            else:
                lines.append(f"  {key}: {item['msg']} (got {item['input']!r:.80})")
        raise ConfigError("\n".join([f"{place}:", *lines])) from error
