"""Base class of the typed configuration files, and the section `expert` with their tuning constants."""

from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from ltm_core.base.errors import ConfigError

_T = TypeVar("_T")
Expert = Annotated[_T, "expert"]
"""Type of a field that has a good default everywhere. A file sets it below its section `expert`, at the same path."""
Written = Annotated[_T, "written"]
"""Type of a field that commands find out and write in place: `ltm init`, `cameras probe`, `pose` and `mask`."""


class StrictModel(BaseModel):
    """Base class of the parts of a YAML file: unknown keys are errors, and values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=(), allow_inf_nan=False)


def problem_text(error: ValueError) -> str:
    """Return an error in one line; of a model, the first three invalid values with their places."""
    if not isinstance(error, ValidationError):
        return str(error)
    found = [(".".join(map(str, e["loc"])), e["msg"].removeprefix("Value error, ")) for e in error.errors()[:3]]
    return "; ".join(f"{place}: {text}" if place else text for place, text in found)


def beside(value: _T, folder: Path) -> _T:
    """Return a section of a file, or a value in it, with all relative paths resolved against a folder."""
    found: Any = value
    if isinstance(value, Path):
        found = folder / value
    elif isinstance(value, BaseModel):
        parts = {name: beside(part, folder) for name, part in value}
        found = value.model_copy(
            update={name: part for name, part in parts.items() if part is not getattr(value, name)}
        )
    elif isinstance(value, tuple):
        found = tuple(beside(part, folder) for part in value)
    elif isinstance(value, dict):
        found = {key: beside(part, folder) for key, part in value.items()}
    return found  # type: ignore[no-any-return]


def is_expert(field: FieldInfo) -> bool:
    return "expert" in field.metadata


def section_models(annotation: object) -> list[type[BaseModel]]:
    """Return the classes of a section: several for a union, such as the kinds of a source."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in section_models(argument)]


def with_expert(model: type[BaseModel], content: dict[Any, Any]) -> dict[Any, Any]:
    """Return the content of a file with the keys of its section `expert` in their places.

    Those of a section that is off have no effect. Raises ConfigError for keys in the wrong part."""
    plain = {key: value for key, value in content.items() if key != "expert"}
    tuning = content.get("expert") or {}
    if not isinstance(tuning, dict):
        raise ConfigError(f"expert: expected a mapping of keys to values, got {type(tuning).__name__}")
    wrong: list[str] = []
    whole = _joined(model, plain, tuning, "", wrong)
    if wrong:
        raise ConfigError("\n".join(wrong))
    return whole


def _joined(
    annotation: object, plain: dict[Any, Any], tuning: dict[Any, Any], above: str, wrong: list[str]
) -> dict[Any, Any]:
    """Return both parts of a section in one. `above`: its place, with a dot at the end. Add keys in the wrong part to
    `wrong`; unknown ones stay, for pydantic to reject."""
    named = get_origin(annotation) is dict  # its keys are the user's names
    joined = {}
    for key, value in {**plain, **tuning}.items():
        place, section, tuned = f"{above}{key}", plain.get(key, {}), tuning.get(key, {})
        field = next((m.model_fields[key] for m in section_models(annotation) if key in m.model_fields), None)
        if not named and field is None:
            joined[key] = value
        elif field is not None and is_expert(field):
            joined[key] = value
            if key in plain:
                wrong.append(f"  {place}: this is a tuning constant; write it as expert.{place}")
        elif not isinstance(tuned, dict):
            wrong.append(f"  expert.{place}: this is not a tuning constant; write it as {place}")
        elif key in tuning and (not isinstance(section, dict) or (named and key not in plain)):
            wrong.append(f"  expert.{place}: there is no section {place}; write it first, in place as a mapping")
        elif not isinstance(section, dict):
            joined[key] = section
        else:
            below = get_args(annotation)[1] if field is None else field.annotation
            both = _joined(below, section, tuned, f"{place}.", wrong)
            if key in plain or field is None or field.get_default(call_default_factory=True) is not None:
                joined[key] = both
    return joined
