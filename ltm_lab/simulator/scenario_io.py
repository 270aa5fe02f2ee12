"""Reads scenario files; errors name the line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from ltm_core.base.errors import ConfigError
from ltm_core.storage.config_io import LARGEST_FILE, parse_yaml
from ltm_core.storage.text_io import read_text
from ltm_lab.simulator.scenario import Scenario

_PLACE = re.compile(
    r"\b(changes|lakes|cameras|walks|dates|smoke)\.(\d+)|\b(terrain)\.(dem|surroundings)\b|\b(vegetation)\.(fuel)\b"
)


def load_scenario(path: Path | str) -> Scenario:
    """Read a scenario file; paths in it are relative to it. Raises ConfigError naming the file, the line, the key and
    what would be right."""
    path = Path(path)
    text = read_text(path, LARGEST_FILE, ConfigError)
    data = parse_yaml(text, str(path))
    if not isinstance(data, dict):
        raise ConfigError(f"scenario {path} must be a mapping of keys, got {type(data).__name__}")
    try:
        scenario = Scenario(**data)
    except ValidationError as e:
        tree = yaml.compose(text)
        problems = [f"{path}:{_line(tree, p['loc'], p['msg'])}: {_told(p)}" for p in e.errors()]
        raise ConfigError("\n".join(problems)) from e
    folder = path.resolve().parent
    changed: dict[str, Any] = {}
    for group, key in (("terrain", "dem"), ("vegetation", "fuel")):
        config = getattr(scenario, group)
        if getattr(config, key) is not None:
            changed[group] = config.model_copy(update={key: folder / getattr(config, key)})
    return scenario.model_copy(update=changed)


def located(path: Path, error: ConfigError) -> ConfigError:
    """`error` with the file and line of the key that its message begins with (`cameras.0`, `lakes.1`), if it does."""
    message = str(error)
    if not _PLACE.match(message):
        return error
    line = _line(yaml.compose(path.read_text(encoding="utf-8")), (), message)
    return ConfigError(f"{path}:{line}: {message}")


def _told(problem: Any) -> str:
    key = ".".join(map(str, problem["loc"])) or "scenario"
    if problem["type"] == "extra_forbidden":
        return f"{key}: unknown key"
    given = problem["input"]
    shown = f" (got {given!r:.60})" if isinstance(given, str | int | float) else ""
    return f"{key}: {problem['msg']}{shown}"


def _line(node: Any, loc: tuple[Any, ...], message: str) -> int:
    """The line (from 1) of the YAML node that `loc` leads to, as far as the file goes along with it.

    Checks of the whole scenario have no `loc`: they begin with the place (`changes.0`, `terrain.dem`).
    """
    if not loc and (found := _PLACE.search(message)):
        loc = tuple(int(part) if part.isdigit() else part for part in found.groups() if part is not None)
    for part in loc:
        if isinstance(node, yaml.MappingNode):
            found_child = next(((k, v) for k, v in node.value if k.value == part), None)
            if found_child is None:
                continue  # the tag of a union, or a key that is missing
            node = found_child[1] if found_child[1].start_mark.line >= found_child[0].start_mark.line else node
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
    return int(node.start_mark.line) + 1
