"""Base class of the typed configuration files, and the section `expert` with their tuning constants."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict
from pydantic.fields import FieldInfo

from ltm_core.base.errors import ConfigError

_T = TypeVar("_T")
Expert = Annotated[_T, "expert"]
"""Type of a field that has a good default everywhere. A file sets it below its section `expert`, at the same path."""

Keys = tuple[str, ...]


class StrictModel(BaseModel):
    """Base class of the parts of a YAML file: unknown keys are errors, and values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=(), allow_inf_nan=False)


class DescribedModel(StrictModel):
    """Base class of a node's parameters. The docstrings of fields are their descriptions in ROS; reading them takes
    some milliseconds for each class."""

    model_config = ConfigDict(use_attribute_docstrings=True)


def is_expert(field: FieldInfo) -> bool:
    return "expert" in field.metadata


def section_models(annotation: object) -> list[type[BaseModel]]:
    """Return the classes of a section: several for a union, such as the kinds of a source."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in section_models(argument)]


def with_expert(model: type[BaseModel], content: dict[Any, Any]) -> dict[Any, Any]:
    """Return the content of a file with the keys of its section `expert` in their places.

    Those of a section that is off have no effect. Raises ConfigError for keys in the wrong part.
    """
    plain = {key: value for key, value in content.items() if key != "expert"}
    tuning = content.get("expert") or {}
    if not isinstance(tuning, dict):
        raise ConfigError(f"expert: expected a mapping of keys to values, got {type(tuning).__name__}")
    wrong = [
        f"  {'.'.join(keys)}: this is a tuning constant; write it as expert.{'.'.join(keys)}"
        for keys, expert in _keys(model, plain)
        if expert
    ]
    wrong += [
        f"  expert.{'.'.join(keys)}: this is not a tuning constant; write it as {'.'.join(keys)}"
        for keys, expert in _keys(model, tuning)
        if not expert
    ]
    if wrong:
        raise ConfigError("\n".join(wrong))
    return _joined(model, plain, tuning, ())


def _keys(annotation: object, content: object, above: Keys = ()) -> Iterator[tuple[Keys, bool]]:
    """Yield each key below `content` that is expert (True) and each other value (False); unknown keys are left out."""
    if not isinstance(content, dict):
        return
    for key, value in content.items():
        keys = (*above, str(key))
        for annotated, expert, _ in _below(annotation, key)[:1]:
            if expert or not isinstance(value, dict):
                yield keys, expert
            else:
                yield from _keys(annotated, value, keys)


def _below(annotation: object, key: object) -> list[tuple[object, bool, bool]]:
    """Return what a key of a section is: its type, whether it is expert, and whether its section is off by default."""
    if get_origin(annotation) is dict:  # its keys are the user's names
        return [(get_args(annotation)[1], False, True)]
    fields = [model.model_fields[str(key)] for model in section_models(annotation) if str(key) in model.model_fields]
    return [
        (field.annotation, is_expert(field), field.get_default(call_default_factory=True) is None) for field in fields
    ]


def _joined(annotation: object, plain: dict[Any, Any], tuning: dict[Any, Any], above: Keys) -> dict[Any, Any]:
    joined = dict(plain)
    for key, value in tuning.items():
        keys = (*above, str(key))
        below = _below(annotation, key)
        if not below or below[0][1] or not isinstance(value, dict):
            joined[key] = value
            continue
        annotated, _, off = below[0]
        section = plain.get(key, {})
        if off and section == {} and key not in plain and get_origin(annotation) is not dict:
            continue  # the section is off
        if not isinstance(section, dict) or (key not in plain and get_origin(annotation) is dict):
            place = ".".join(keys)
            raise ConfigError(f"  expert.{place}: there is no section {place}; write it first, in place as a mapping")
        joined[key] = _joined(annotated, section, value, keys)
    return joined
