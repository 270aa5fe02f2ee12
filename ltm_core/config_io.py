"""Reads YAML files into typed configuration; errors name the file, the key and the value."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from ltm_core.errors import ConfigError

Model = TypeVar("Model", bound=BaseModel)
Keys = tuple[int | str, ...]


class _UniqueKeys(yaml.SafeLoader):
    """Refuses a key that stands twice in a mapping: PyYAML would drop all but the last, a whole camera perhaps."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        "in a mapping", node.start_mark, f"the key {key.value!r} stands twice", key.start_mark
                    )
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def load_yaml(path: Path | str, model: type[Model]) -> Model:
    """Read a YAML mapping into `model`. Raises ConfigError: no file, no YAML, keys unknown or twice, wrong values."""
    path = Path(path)
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), _UniqueKeys)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not YAML ({error})") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected a mapping of keys to values, got {type(content).__name__}")
    return checked(model, content, str(path), line_of=lambda keys: _line_of(path, keys))


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
                lines.append(f"  {key}: {item['msg']} (got {item['input']!r:.80}{at})")
        raise ConfigError("\n".join([f"{place}:", *lines])) from error


def _line_of(path: Path, keys: Keys) -> int | None:
    """The line on which a key stands in a YAML file; sections that the file does not have are stepped over."""
    node = yaml.compose(path.read_text(encoding="utf-8"), yaml.SafeLoader)
    line = None
    for key in keys:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
            node = node.value[key]
            line = node.start_mark.line + 1
        elif isinstance(node, yaml.MappingNode):
            for name, value in node.value:
                if name.value == str(key):
                    node, line = value, name.start_mark.line + 1
                    break
    return line
