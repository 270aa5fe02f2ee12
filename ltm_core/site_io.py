"""Reads site files (`config/sites/*.yaml`)."""

from __future__ import annotations

from pathlib import Path

from ltm_core.config_io import load_yaml
from ltm_core.disk_io import is_file
from ltm_core.errors import ConfigError
from ltm_core.ptz_config import PtzSettings
from ltm_core.site import Site
from ltm_core.site_sections import CameraConfig, DemConfig
from ltm_core.source_config import FolderConfig, HttpSettings, NetworkSettings
from ltm_core.uplink.region_io import broker_beside


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
        "heads": None if site.heads is None else path.parent / site.heads,
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
    """With the masks' files beside the site file. Raises ConfigError."""
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
    """A site may come from elsewhere: it names no file outside its folder. Raises ConfigError."""
    try:
        file = (folder / path).resolve()
        inside = file.is_relative_to(folder)
    except (OSError, ValueError, RuntimeError) as error:  # a name that no file can have, links in a circle
        raise ConfigError(f"{place}: {str(path)!r} is no file ({error})") from error
    if not inside:
        raise ConfigError(f"{place}: {path} leads out of the site's folder; copy the mask into {folder}")
    return file


def _source_beside(camera: CameraConfig, folder: Path) -> CameraConfig:
    """With the paths of its source and of its head below the site file's folder."""
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
