"""Read site files, and change the sections of a camera in a site file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import beside
from ltm_core.site.site import Site
from ltm_core.storage.config_io import LARGEST_FILE, compose_yaml, load_yaml, parse_yaml, read_text, read_yaml
from ltm_core.storage.disk_io import is_file, sync, written_whole


def load_site(path: Path | str) -> Site:
    """Read a site YAML; its relative paths become relative to the file. Raises ConfigError, see `config_io`."""
    path = Path(path).expanduser().resolve()
    site = beside(load_yaml(path, Site), path.parent)
    changes: dict[str, object] = {}
    for name in ("model", "depth_model"):
        file = path.parent / getattr(site, name)
        if file.suffix == ".yaml" and is_file(file):
            changes[name] = str(file)
    if site.fuel.label_errors is not None:
        changes["fuel"] = site.fuel.model_copy(update={"label_errors": str(path.parent / site.fuel.label_errors)})
    for name, camera in site.cameras.items():
        place = f"{path}: cameras.{name}"
        _check_mask(camera.mask, f"{place}.mask", path.parent)
        for view in camera.view_masks:
            _check_mask(view.mask, f"{place}.view_masks.{view.name}", path.parent)
    return site.model_copy(update=changes)


def _check_mask(mask: object, place: str, folder: Path) -> None:
    """Check that a site, whose source may be untrusted, names no file outside its folder. Raises ConfigError."""
    if not isinstance(mask, Path):
        return
    try:
        inside = mask.resolve().is_relative_to(folder)
    except (OSError, ValueError, RuntimeError) as error:  # a name that no file can have, links in a circle
        raise ConfigError(f"{place}: {str(mask)!r} is not a file ({error})") from error
    if not inside:
        raise ConfigError(f"{place}: {mask} is outside the site's folder; copy the mask into {folder}")


def write_camera(path: Path | str, camera: str, sections: dict[str, Any], replace: bool = True) -> None:
    """Write sections of a camera into a site file, and add the camera if it is missing; all other lines stay.

    The new file is read as a site before it takes the old one's place. Raises ConfigError, and leaves the file
    unchanged, if the result is no site, or without `replace` if a section exists with another content."""
    path = Path(path)
    text, present = read_text(path, LARGEST_FILE, ConfigError), stated_sections(path, camera)
    changed = {key: section for key, section in sections.items() if present.get(key) != section}
    if not replace and (differing := [key for key in changed if key in present]):
        raise ConfigError(
            f"{path} was not changed: camera {camera} already has {' and '.join(differing)}; pass --replace to "
            "overwrite"
        )
    for key, section in changed.items():
        text = edited(text, ("cameras", camera, key), section, str(path))
    replace_site(path, text)


def stated_sections(path: Path, camera: str) -> dict[str, Any]:
    """Return what a site file states about a camera; empty without the camera. Raises ConfigError, see `read_yaml`."""
    node = read_yaml(path)
    for key in ("cameras", camera):
        node = node.get(key) if isinstance(node, dict) else None
    return node if isinstance(node, dict) else {}


def edited(text: str, keys: Sequence[str | int], value: object, place: str, note: str = "") -> str:
    """Return a YAML text with `value`, and `note` as a comment behind it, at the path `keys`; other lines stay.

    A number in `keys` is an item of a list, or a new one behind its last. A mapping or list in brackets on the way is
    rewritten in lines. Raises ConfigError if something on the way is no mapping, or has comments within its brackets.
    """
    text += "" if text.endswith("\n") else "\n"  # so that the last node, too, ends where a line begins
    node, content, way = compose_yaml(text, place), parse_yaml(text, place), list(keys)
    lines = text.splitlines(keepends=True)
    found: tuple[int, str | int, yaml.Node] | None = None
    while way and isinstance(node, yaml.CollectionNode) and node.value and not node.flow_style:
        entries = _entries(node, lines)
        indent = (node if isinstance(node, yaml.SequenceNode) else node.value[0][0]).start_mark.column
        if way[0] not in entries:
            at = _end(lines, node)
            return "".join([*lines[:at], *_block(way[0], _with(None, way[1:], value), indent, note), *lines[at:]])
        begin, node = entries[way[0]]
        found, content = (begin, way[0], node), content[way.pop(0)]
    if found is None or not (
        content is None or not way or isinstance(content, list if isinstance(way[0], int) else dict)
    ):
        where = ".".join(map(str, keys[: len(keys) - len(way)])) or "the file"
        raise ConfigError(f"{place}: {where} is not a mapping; write each of its keys on its own line")
    begin, key, node = found
    last, end = node.end_mark, _end(lines, node)
    block = _block(key, _with(content, way, value), indent, note)
    if way and last.line > begin and any("#" in line for line in lines[begin : last.line]):
        raise ConfigError(f"{place}: {key}: has comments within brackets; write each key on its own line")
    behind = lines[last.line][last.column :].strip() if last.line < len(lines) else ""
    if behind.startswith("#") and (way or (isinstance(value, list) and content in value)):
        block[0] = f"{block[0].rstrip()}   {behind}\n"
    block[0] = lines[begin][:indent] + block[0][indent:]  # a first key stays behind its item's dash
    return "".join([*lines[:begin], *block, *lines[end:]])


def _entries(node: yaml.CollectionNode, lines: list[str]) -> dict[str | int, tuple[int, yaml.Node]]:
    """Return, by key or number, the first line and the value of what a mapping or list in lines contains."""
    if isinstance(node, yaml.MappingNode):
        return {key.value: (key.start_mark.line, value) for key, value in node.value}
    dash = node.start_mark.column
    begins = [
        i
        for i in range(node.start_mark.line, node.end_mark.line + 1)
        if lines[i : i + 1] and lines[i][dash:][:1] == "-"
    ]
    return {k: (max(i for i in begins if i <= item.start_mark.line), item) for k, item in enumerate(node.value)}


def _with(content: Any, keys: Sequence[str | int], value: object) -> Any:
    """Return nested mappings and lists with `value` at the path `keys`."""
    if not keys:
        return value
    if isinstance(keys[0], int):
        items = list(content or ())
        return [*items[: keys[0]], _with(None, keys[1:], value), *items[keys[0] + 1 :]]
    known = content if isinstance(content, dict) else {}
    return {**known, keys[0]: _with(known.get(keys[0]), keys[1:], value)}


def _end(lines: list[str], node: yaml.Node) -> int:
    """Return the line behind a node; comments and empty lines behind it belong to what follows."""
    # What is written in lines ends where the next thing begins.
    in_lines = isinstance(node, yaml.CollectionNode) and not node.flow_style
    end = node.end_mark.line + (0 if in_lines else 1)
    end = max(end, node.start_mark.line + 1)
    while end > node.start_mark.line + 1 and (not lines[end - 1].strip() or lines[end - 1].lstrip().startswith("#")):
        end -= 1
    return end


def _block(key: str | int, value: object, indent: int, note: str = "") -> list[str]:
    """Return the lines of a key, or of a list's item, with its value and a comment behind the last."""
    item = isinstance(key, int)
    content = [value, {}] if item else {key: value}  # with a second item, no list is written in brackets
    text = yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=110, allow_unicode=True)
    lines = [" " * indent + line + "\n" for line in text.splitlines()[: -1 if item else None]]
    if note:
        lines[-1] = f"{lines[-1].rstrip()}  # {' '.join(note.split())}\n"
    return lines


class _Dumper(yaml.SafeDumper):
    """Short lists, and mappings within lists, on one line."""

    def represent_sequence(self, tag: Any, sequence: Any, flow_style: Any = None) -> Any:
        flat = all(not isinstance(item, dict | list | tuple) for item in sequence)
        return super().represent_sequence(tag, sequence, flow_style=flat)

    def represent_mapping(self, tag: Any, mapping: Any, flow_style: Any = None) -> Any:
        point = isinstance(mapping, dict) and "zoom" in mapping and "hfov_deg" in mapping
        return super().represent_mapping(tag, mapping, flow_style=True if point else flow_style)


def dumped(content: dict[str, Any]) -> str:
    """Return YAML text in the style of a site file."""
    return "".join(line for key, value in content.items() for line in _block(key, value, 0))


def replace_site(path: Path, text: str) -> None:
    """Write the text of a site file in place of the old one, whole or not at all. Raises ConfigError if invalid."""
    with written_whole(path) as new:  # beside the old file, so that relative paths hold
        new.write_text(text, encoding="utf-8")
        new.chmod(path.stat().st_mode & 0o777)
        sync(new)
        try:
            load_site(new)
        except ConfigError as error:
            why = str(error).replace(str(new.resolve()), "with the change")
            raise ConfigError(f"{path} was not changed: {why}") from error
