"""Write a commented site file, and change the file of a site without losing what the user wrote."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.geodesy import read_crs
from ltm_core.site.site_io import edited, replace_site
from ltm_core.storage.config_io import LARGEST_FILE, parse_yaml, read_text
from ltm_ros.site_setup.layers import Layer
from ltm_ros.site_setup.vertical import Datum

_CODE_RULES = ("barriers", "unknown_codes", "own_fbfm13")
"""Keys of `fuel.prior` that hold for a newer fuel map, too."""


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
    if not cameras:  # a site file needs at least one
        lines.append("  north: {}  # add yours: ltm init --out FOLDER --camera NAME=LON,LAT,...")
    text = "\n".join(lines) + "\n"
    return changed(text, {}, cameras, "site.yaml") if cameras else text


def changed(text: str, layers: Mapping[str, Layer], cameras: Mapping[str, Mapping[str, Any]], place: str) -> str:
    """Return the text of a site file with other rasters and more cameras; the rest stays as the user wrote it.

    Raises ConfigError for a text that is not YAML."""
    for key, layer in layers.items():
        site = parse_yaml(text, place)
        keys: tuple[str | int, ...] = (key,)
        value: object = {"path": layer.path.name}
        if key in ("dem", "coarser"):
            dems = site["dem"]
            if not isinstance(dems, list):
                text = edited(text, ("dem",), [dems], place)
            keys = ("dem", 0 if key == "dem" else 1)
        elif key == "fuel":
            prior = (site.get("fuel") or {}).get("prior")
            kept = {k: v for k, v in prior.items() if k in _CODE_RULES} if isinstance(prior, dict) else {}
            name = f"{layer.path.name}/"
            keys, value = ("fuel", "prior"), {"path": name, **kept} if kept else name
        text = edited(text, keys, value, place, layer.described)
    for name, camera in cameras.items():
        text = edited(text, ("cameras", name), camera, place)
    return text


def change_site(path: Path, layers: Mapping[str, Layer], cameras: Mapping[str, Mapping[str, Any]]) -> None:
    """Change a site file in place, if the result is a valid site. Raises ConfigError, and leaves the file as it is."""
    text = read_text(path, LARGEST_FILE, ConfigError)
    replace_site(path, changed(text, layers, cameras, str(path)))


def free_name(folder: Path, name: str) -> str:
    """Return `name`, or with a number what does not exist in a folder yet: dem_2.tif."""
    stem, dot, suffix = name.partition(".")
    names: Sequence[str] = [name, *(f"{stem}_{k}{dot}{suffix}" for k in range(2, 1000))]
    return next(name for name in names if not (folder / name).exists())
