"""Write the tables of the site file's keys into the documentation, from the classes that read the file.

MkDocs runs `on_page_markdown` for each page: a line `{site keys: GROUP}` becomes the table of the group's keys, and
`{expert keys}` and `{written keys}` the tables of the tuning constants and of what commands write.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from ltm_core.base.strict_model import is_expert, section_models
from ltm_core.site.site import Site

GROUPS: dict[str, tuple[str, ...]] = {
    "site": ("name", "crs", "origin"),
    "terrain": ("dem", "surface", "possible_ground", "terrain"),
    "cameras": ("cameras", "refine_poses"),
    "fuel": ("fuel", "model", "depth_model"),
    "outputs": ("locating",),
    "tower": (),
}
"""Groups of the file's sections; `tower` has those that no other group names."""


@dataclass(frozen=True)
class Key:
    path: str
    kinds: tuple[str, ...]
    """Kinds of a section (`source.kind`) that have the key; empty: all."""
    type: str
    default: str
    meaning: str
    expert: bool
    written: bool = False
    """Whether commands find it out and write it."""

    @property
    def section(self) -> str:
        return self.path.split(".")[0]


@cache
def meanings(model: type[BaseModel]) -> dict[str, str]:
    """Return the docstring of each field, by name, with those of the base classes."""
    found: dict[str, str] = {}
    for base in reversed([base for base in model.__mro__ if issubclass(base, BaseModel) and base is not BaseModel]):
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        assert isinstance(tree, ast.ClassDef)
        for field, text in zip(tree.body, tree.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                words = text.value.value if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) else ""
                if words or field.target.id not in found:
                    found[field.target.id] = " ".join(str(words).split())
    return found


def keys(
    model: type[BaseModel] = Site,
    above: str = "",
    expert: bool = False,
    written: bool = False,
    seen: frozenset[tuple[type[BaseModel], str]] = frozenset(),
) -> Iterator[Key]:
    """Yield every key of a file, sections before what they contain; a section that occurs again, such as a password, is
    yielded without its keys. `coarser` is no key: it is the rest of the list `dem`."""
    for name, field in model.model_fields.items():
        owner = _owner(model, name)
        if (model, name) == (Site, "coarser") or (owner, name) in seen:
            continue
        path, tuning, found_out = f"{above}{name}", expert or is_expert(field), written or "written" in field.metadata
        yield Key(path, (), type_of(field), default_of(field), meanings(model).get(name, ""), tuning, found_out)
        seen |= set() if tuning else {(owner, name)}
        models = section_models(field.annotation)
        below = f"{path}.{'NAME.' if _is_mapping(field.annotation) else ''}"
        parts = [(kind_of(part), key) for part in models for key in keys(part, below, tuning, found_out, seen)]
        yield from _merged(parts, len(models))
        if not tuning:
            seen |= {(_owner(part, key), key) for part in _below(models) for key in part.model_fields}


def _owner(model: type[BaseModel], name: str) -> type[BaseModel]:
    """Return the class that declares a field first."""
    return next(base for base in reversed(model.__mro__) if name in inspect.get_annotations(base))


def _below(models: list[type[BaseModel]]) -> Iterator[type[BaseModel]]:
    for model in models:
        yield model
        yield from _below([part for field in model.model_fields.values() for part in section_models(field.annotation)])


def _merged(found: list[tuple[str, Key]], models: int) -> Iterator[Key]:
    """Yield the keys of the kinds of a section, each once."""
    by_path: dict[str, list[tuple[str, Key]]] = {}
    for kind, key in found:
        by_path.setdefault(key.path, []).append((kind, key))
    for several in by_path.values():
        kinds = tuple(kind for kind, _ in several) if len(several) < models else several[0][1].kinds
        first = several[0][1]
        types = dict.fromkeys(key.type for _, key in several)
        defaults = dict.fromkeys(key.default for _, key in several)
        meaning = max((key.meaning for _, key in several), key=len)
        yield Key(first.path, kinds, " or ".join(types), " or ".join(defaults), meaning, first.expert, first.written)


def kind_of(model: type[BaseModel]) -> str:
    field = model.model_fields.get("kind")
    return str(get_args(field.annotation)[0]) if field is not None and get_args(field.annotation) else ""


def _is_mapping(annotation: object) -> bool:
    return get_origin(annotation) is dict


def type_of(field: FieldInfo) -> str:
    return _type(field.annotation)


def _type(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if isinstance(annotation, type):
        if issubclass(annotation, BaseModel):
            return "section"
        return {str: "text", float: "number", int: "integer", bool: "true, false", Path: "path"}.get(
            annotation, "value"
        )
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in arguments)
    if origin is dict:
        return "section for each name"
    if origin is Annotated:
        return _type(arguments[0])
    if origin in (tuple, list):
        items = " or ".join(_plural(name) for name in dict.fromkeys(_type(a) for a in arguments if a is not Ellipsis))
        return f"list of {items}" if origin is list or Ellipsis in arguments else f"list of {len(arguments)} {items}"
    return " or ".join(dict.fromkeys(_type(argument) for argument in arguments if argument is not type(None)))


def _plural(name: str) -> str:
    return name.replace("list of", "lists of") if name.startswith(("`", "list of")) else f"{name}s"


def default_of(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value is PydanticUndefined or value in ("", (), {}) or isinstance(value, BaseModel):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(str(getattr(item, 'zoom', item)) for item in value)}]"
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def group_of(key: Key) -> str:
    return next((group for group, sections in GROUPS.items() if key.section in sections), "tower")


def table(rows: list[Key]) -> str:
    lines = ["| key | type | default | meaning |", "|---|---|---|---|"]
    for key in rows:
        only = f" Only for {', '.join(f'`{kind}`' for kind in key.kinds)}." if key.kinds else ""
        default = f"`{key.default}`" if key.default not in ("", "required") else key.default
        cells = (f"`{key.path}`", key.type, default, key.meaning + only)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)


def on_page_markdown(markdown: str, **_: object) -> str:
    """Replace the marks of a page (a hook of MkDocs)."""

    def of_group(match: re.Match[str]) -> str:
        return table([key for key in keys() if not (key.expert or key.written) and group_of(key) == match[1]])

    text = re.sub(r"^\{site keys: (\w+)\}$", of_group, markdown, flags=re.MULTILINE)
    if "{expert keys}" in text:
        text = text.replace("{expert keys}", table([key for key in keys() if key.expert]))
    if "{written keys}" in text:
        text = text.replace("{written keys}", table([key for key in keys() if key.written and not key.expert]))
    return text


if __name__ == "__main__":
    print(on_page_markdown(Path("docs/api/site.md").read_text()))
