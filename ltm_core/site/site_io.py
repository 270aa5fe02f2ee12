"""Read site files, and change one section of a camera in a site file."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import yaml

from ltm_core.base.errors import ConfigError
from ltm_core.site.sections import CameraConfig, DemConfig
from ltm_core.site.site import Site
from ltm_core.site.source_config import FolderConfig, HttpSettings, NetworkSettings, PtzSettings
from ltm_core.storage.config_io import LARGEST_FILE, compose_yaml, load_yaml
from ltm_core.storage.disk_io import is_file
from ltm_core.storage.text_io import read_text
from ltm_core.uplink.config import broker_beside


def load_site(path: Path | str) -> Site:
    """Read a site YAML; its relative paths become relative to the file. Raises ConfigError, see `config_io`."""
    path = Path(path).expanduser().resolve()
    site = load_yaml(path, Site)

    def beside_the_file(dem: DemConfig) -> DemConfig:
        return dem.model_copy(update={"path": path.parent / dem.path})

    changes: dict[str, object] = {
        "dem": beside_the_file(site.dem),
        "coarser": tuple(beside_the_file(dem) for dem in site.coarser),
        "surface": None if site.surface is None else beside_the_file(site.surface),
        "label_heads": None if site.label_heads is None else path.parent / site.label_heads,
    }
    for name in ("model", "depth_model"):
        beside = path.parent / getattr(site, name)
        if beside.suffix == ".yaml" and is_file(beside):
            changes[name] = str(beside)
    changes["cameras"] = {
        name: _source_beside(_with_mask(name, camera, path), path.parent) for name, camera in site.cameras.items()
    }
    if site.health is not None:
        given = {name: getattr(site.health, name) for name in ("certificate", "key", "token")}
        files = {name: path.parent / file for name, file in given.items() if file is not None}
        changes["health"] = site.health.model_copy(update=files)
    if site.region is not None:
        broker = broker_beside(site.region.broker, path.parent)
        changes["region"] = site.region.model_copy(update={"broker": broker})
    fuel: dict[str, object] = {}
    if site.fuel.prior is not None:
        fuel["prior"] = site.fuel.prior.below(path.parent)
    if site.fuel.label_errors is not None:
        fuel["label_errors"] = str(path.parent / site.fuel.label_errors)
    if fuel:
        changes["fuel"] = site.fuel.model_copy(update=fuel)
    return site.model_copy(update=changes)


def _with_mask(name: str, camera: CameraConfig, site: Path) -> CameraConfig:
    """Resolve the masks' files against the site file's folder. Raises ConfigError."""
    place = f"{site}: cameras.{name}"
    changes: dict[str, object] = {}
    if isinstance(camera.mask, Path):
        changes["mask"] = _mask_file(camera.mask, f"{place}.mask", site.parent)
    if any(isinstance(view.mask, Path) for view in camera.view_masks):
        changes["view_masks"] = tuple(
            view.model_copy(update={"mask": _mask_file(view.mask, f"{place}.view_masks.{view.name}", site.parent)})
            if isinstance(view.mask, Path)
            else view
            for view in camera.view_masks
        )
    return camera.model_copy(update=changes) if changes else camera


def _mask_file(path: Path, place: str, folder: Path) -> Path:
    """Check that a site, which may be from an untrusted source, names no file outside its folder. Raises
    ConfigError."""
    try:
        file = (folder / path).resolve()
        inside = file.is_relative_to(folder)
    except (OSError, ValueError, RuntimeError) as error:  # a name that no file can have, links in a circle
        raise ConfigError(f"{place}: {str(path)!r} is not a file ({error})") from error
    if not inside:
        raise ConfigError(f"{place}: {path} is outside the site's folder; copy the mask into {folder}")
    return file


def _source_beside(camera: CameraConfig, folder: Path) -> CameraConfig:
    """Resolve the paths of a camera's source and PTZ head against the site file's folder."""
    found: dict[str, object] = {}
    for name, section in (("source", camera.source), ("ptz", camera.ptz)):
        changes: dict[str, object] = {}
        if isinstance(section, FolderConfig):
            changes["path"] = folder / section.path
        if isinstance(section, HttpSettings | PtzSettings) and section.ca is not None:
            changes["ca"] = folder / section.ca
        if isinstance(section, NetworkSettings | PtzSettings) and section.password and section.password.file:
            changes["password"] = section.password.model_copy(update={"file": folder / section.password.file})
        if section is not None and changes:
            found[name] = section.model_copy(update=changes)
    return camera.model_copy(update=found) if found else camera


def write_camera_section(path: Path | str, camera: str, key: str | None, section: dict[str, Any]) -> None:
    """Set `cameras: CAMERA: KEY:` in a site file to `section`; a camera that is not there is added. Without a key,
    `section` is all of a camera that is not there.

    The new file is read as a site before it takes the old one's place. Raises ConfigError, and leaves the file as it
    is, where it cannot be read, or where the camera is written within braces so that no lines can be put into it.
    """
    path = Path(path)
    text = read_text(path, LARGEST_FILE, ConfigError)
    replace_site(path, edited(text, camera, key, section, str(path)))


def edited(text: str, camera: str, key: str | None, section: dict[str, Any], place: str) -> str:
    """Return the text of a site file with the section; see `write_camera_section`."""
    root = compose_yaml(text, place)
    cameras = _value(root, "cameras")
    lines = text.splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    if cameras is None or not isinstance(cameras, yaml.MappingNode) or cameras.flow_style or not cameras.value:
        raise ConfigError(f"{place}: has no multi-line section `cameras:` to add {camera} to")
    step = cameras.value[0][0].start_mark.column
    found = _value(cameras, camera)
    if found is None:
        content = section if key is None else {key: section}
        return "".join(_inserted(lines, _end(lines, cameras), _block({camera: content}, step)))
    if key is None:
        raise ConfigError(f"{place}: camera {camera} exists already")
    if not isinstance(found, yaml.MappingNode) or found.flow_style:
        raise ConfigError(f"{place}: camera {camera} is written in braces on one line: write each key on its own line")
    indent = found.value[0][0].start_mark.column if found.value else 2 * step
    old = next((pair for pair in found.value if pair[0].value == key), None)
    if old is None:
        return "".join(_inserted(lines, found.value[0][0].start_mark.line, _block({key: section}, indent)))
    begin, end = old[0].start_mark.line, _end(lines, old[1])
    return "".join([*lines[:begin], *_block({key: section}, indent), *lines[end:]])


def _inserted(lines: list[str], at: int, block: list[str]) -> list[str]:
    return [*lines[:at], *block, *lines[at:]]


def _value(node: yaml.Node | None, key: str) -> Any:
    if not isinstance(node, yaml.MappingNode):
        return None
    return next((value for name, value in node.value if name.value == key), None)


def _end(lines: list[str], node: yaml.Node) -> int:
    """Return the line behind a node; comments and empty lines behind it belong to what follows."""
    # What is written in lines ends where the next thing begins.
    in_lines = isinstance(node, yaml.CollectionNode) and not node.flow_style
    end = node.end_mark.line + (0 if in_lines else 1)
    if in_lines and end == len(lines) - 1 and node.end_mark.column:
        end = len(lines)
    end = max(end, node.start_mark.line + 1)
    while end > node.start_mark.line + 1 and (not lines[end - 1].strip() or lines[end - 1].lstrip().startswith("#")):
        end -= 1
    return end


def _block(content: dict[str, Any], indent: int) -> list[str]:
    text = yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=110, allow_unicode=True)
    return [" " * indent + line + "\n" for line in text.splitlines()]


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
    return "".join(_block(content, 0))


def replace_site(path: Path, text: str) -> None:
    """Write the text of a site file in place of the old one, whole or not at all. Raises ConfigError if it is not a
    valid site."""
    # Beside the old file, so that relative paths hold.
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    new = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        try:
            load_site(new)
        except ConfigError as error:
            raise ConfigError(f"{path} was not changed: {str(error).replace(str(new), 'with the change')}") from error
        new.chmod(path.stat().st_mode & 0o777)
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)
