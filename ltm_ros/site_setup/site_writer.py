"""Write a commented site file, and change the file of a site without losing what the user wrote."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.geodesy import read_crs
from ltm_core.site.site_io import replace_site
from ltm_core.storage.config_io import LARGEST_FILE, parse_yaml, read_text
from ltm_ros.site_setup.layers import Layer
from ltm_ros.site_setup.vertical import Datum

PLACEHOLDER = "north"
"""Name of the camera of a site for which none was given; a site file needs at least one."""


def site_text(
    name: str,
    crs: str,
    origin: tuple[float, float],
    datum: Datum | None,
    layers: Mapping[str, Layer],
    cameras: Mapping[str, Mapping[str, Any]],
) -> str:
    """Return the text of a new site file. `layers`: by key (dem, coarser, surface, fuel)."""
    heights = f"{datum.name} ({datum.code})" if datum else "unknown, because the DEM states none"
    lines = [
        "# Written by `ltm init`. Edit it as you like: `ltm init --update` keeps your keys and comments.",
        "# Check it with `ltm check`. docs/site.md explains the keys.",
        f"name: {name}",
        f"crs: {crs}  # {read_crs(crs).name}",
        f"origin: [{origin[0]:.0f}, {origin[1]:.0f}]  # (x, y) in the CRS that is (0, 0) of the map frame",
        f"# Vertical datum of all heights in this file and in the rasters: {heights}.",
        "dem:  # from the finest to the coarsest",
    ]
    for key in ("dem", "coarser"):
        if key in layers:
            lines.append(f"  - path: {layers[key].path.name}  # {layers[key].described}")
    if "surface" in layers:
        lines += ["surface:  # elevation of tree tops and roofs"]
        lines += [f"  path: {layers['surface'].path.name}  # {layers['surface'].described}"]
    if "fuel" in layers:
        lines += ["fuel:", f"  prior: {layers['fuel'].path.name}/  # {layers['fuel'].described}"]
    lines.append("cameras:")
    if not cameras:
        lines.append(f"  {PLACEHOLDER}: {{}}  # add yours: ltm init --out FOLDER --camera NAME=LON,LAT,...")
    text = "\n".join(lines) + "\n"
    return changed(text, {}, cameras, "site.yaml") if cameras else text


def changed(text: str, layers: Mapping[str, Layer], cameras: Mapping[str, Mapping[str, Any]], place: str) -> str:
    """Return the text of a site file with other rasters and more cameras; the rest stays as the user wrote it.

    Raises ConfigError for a text that is not YAML.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.comments import CommentedMap, CommentedSeq

    parse_yaml(text, place)  # within bounds, which ruamel.yaml does not have
    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 10_000
    yaml.indent(mapping=2, sequence=4, offset=2)
    site = yaml.load(text)
    if not isinstance(site, CommentedMap):
        raise ConfigError(f"{place}: expected a mapping of keys to values")
    for key, layer in layers.items():
        new = CommentedMap({"path": layer.path.name})
        if key in ("dem", "coarser"):
            _set_dem(site, key, new, layer.described, CommentedSeq)
        elif key == "surface":
            site["surface"] = new
            new.yaml_add_eol_comment(layer.described, "path")
        else:
            fuel = site.setdefault("fuel", CommentedMap())
            if isinstance(fuel.get("prior"), dict):
                kept = {k: v for k, v in fuel["prior"].items() if k in ("barriers", "unknown_codes", "own_fbfm13")}
                fuel["prior"] = CommentedMap({"path": f"{layer.path.name}/", **kept})
            else:
                fuel["prior"] = f"{layer.path.name}/"
                fuel.ca.items.pop("prior", None)
                fuel.yaml_add_eol_comment(layer.described, "prior")
    there = site.get("cameras")
    if cameras and not isinstance(there, dict):
        there = site["cameras"] = CommentedMap()
    for name, camera in cameras.items():
        there[name] = _mapping(camera)
        there.fa.set_block_style()
    out = StringIO()
    yaml.dump(site, out)
    return out.getvalue()


def _set_dem(site: Any, key: str, new: Any, described: str, sequence: Any) -> None:
    """Set the finest, or the second, raster of a site's DEMs."""
    dems = site["dem"]
    if not isinstance(dems, list):
        dems = site["dem"] = sequence([dems, *site.pop("coarser", [])])
    at = 0 if key == "dem" else 1
    if at < len(dems):
        dems[at] = new
    else:
        dems.append(new)
    new.yaml_add_eol_comment(described, "path")


def _mapping(content: Mapping[str, Any]) -> Any:
    """Return a section with its own sections in braces, as people write them."""
    from ruamel.yaml.comments import CommentedMap

    made = CommentedMap()
    for key, value in content.items():
        made[key] = value
        if isinstance(value, Mapping):
            made[key] = flow = CommentedMap(value)
            flow.fa.set_flow_style()
    return made


def change_site(path: Path, layers: Mapping[str, Layer], cameras: Mapping[str, Mapping[str, Any]]) -> None:
    """Change a site file in place, if the result is a valid site. Raises ConfigError, and leaves the file as it is."""
    text = read_text(path, LARGEST_FILE, ConfigError)
    replace_site(path, changed(text, layers, cameras, str(path)))


def free_name(folder: Path, name: str) -> str:
    """Return `name`, or with a number what does not exist in a folder yet: dem_2.tif."""
    stem, dot, suffix = name.partition(".")
    names: Sequence[str] = [name, *(f"{stem}_{k}{dot}{suffix}" for k in range(2, 1000))]
    return next(name for name in names if not (folder / name).exists())
