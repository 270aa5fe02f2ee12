"""Write config/sites/example.yaml, the site file with every key, from the configuration classes and their docstrings.

    python tools/site_file.py

`EXAMPLE` holds what has no default. A key is explained where it first occurs; a key without a value is a comment.
"""

import importlib
import inspect
import textwrap
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel
from site_reference import meanings

from ltm_core.base.strict_model import is_expert
from ltm_core.site.site import Site
from ltm_ros.launching.graph import NODE_TYPES, NODES_MODULE, OWN_PARAMETERS

FILE = Path(__file__).parents[1] / "config/sites/example.yaml"
HEADER = """\
# A site file with every key and its default, written by tools/site_file.py. Do not copy it: begin with minimal.yaml,
# and take from here what you need. A key that you omit has the default shown here. docs/site.md explains the file.
"""
LOGIN = {"user": "viewer", "password": {"credential": "north"}}
FIXED = {
    "calibration": {"width": 1920, "height": 1080, "hfov_deg": 54.2},
    "pose": {"lon": -118.06, "lat": 34.22, "height_above_ground": 20.0, "azimuth_deg": 214.0},
}


def turning(**ptz: Any) -> dict[str, Any]:
    mount = {"x": 1560.0, "y": 2490.0, "z": 846.7, "azimuth_deg": 30.0, "lens": {"width": 1920, "height": 1080}}
    return {"source": {"kind": "snapshot", "url": "http://192.168.1.21/snapshot.jpg"}, "ptz": ptz, "mount": mount}


EXAMPLE: dict[str, Any] = {
    "name": "ridge",
    "crs": "EPSG:32611",
    "origin": [346000.0, 3783000.0],
    "dem": {"path": "dem.tif"},
    "surface": {"path": "canopy_top.tif"},
    "fuel": {"prior": {"path": "landfire/", "barriers": [{"path": "roads.geojson", "kind": "road"}]}},
    "depth_model": "landscape_v5_depth",
    "terrain": {},
    "locating": {},
    "refine_poses": {},
    "health": {},
    "alerts": {
        "webhook": "https://hooks.example.org/{token}",
        "token": {"credential": "hook"},
        "mqtt": "mqtts://10.8.0.1",
        "user": "ridge",
        "password": {"credential": "mqtt"},
        "ca": "ca.crt",
    },
    "region": {
        "name": "valley",
        "tower": "ridge",
        "broker": {"host": "10.8.0.1", "ca": "ca.crt", "certificate": "ridge.crt", "key": "ridge.key"},
    },
    "cameras": {
        "north": {
            "source": {"kind": "snapshot", "url": "http://192.168.1.20/snapshot.jpg", **LOGIN},
            "mask": "north_mask.png",
            **FIXED,
        },
        "east": {"source": {"kind": "mjpeg", "url": "http://192.168.1.22/stream.mjpg"}, **FIXED},
        "south": {"source": {"kind": "rtsp", "url": "rtsp://192.168.1.23/stream1"}, **FIXED},
        "upload": {"source": {"kind": "folder", "path": "uploads/"}, **FIXED},
        "list": {
            "source": {
                "kind": "camera_list",
                "url": "https://cameras.example.org/all.json",
                "id": "Axis-Ridge",
                "image": "https://cameras.example.org/{id}/latest-frame.jpg",
            },
            **FIXED,
        },
        "turning": {
            **turning(kind="vapix"),
            "view_masks": [
                {
                    "name": "mast",
                    "azimuth_deg": 271.5,
                    "pitch_deg": -4.0,
                    "mask": [{"class": "structure", "polygon": [[0, 0], [99, 0], [99, 1079], [0, 1079]]}],
                }
            ],
        },
        "hikvision": turning(kind="isapi", units="tenths"),
        "other": turning(kind="onvif"),
        "phone": {"sensors": {}},
        "driver": {"topics": {"image": "/rig/camera/image_raw"}},
    },
}


class SiteFile:
    """The lines of a site file."""

    def __init__(self, expert: bool = False) -> None:
        """`expert`: whether sections show their tuning constants."""
        self.lines: list[str] = []
        self._expert = expert
        self._shown: set[tuple[type, str]] = set()

    def keys(self, model: BaseModel, indent: int, leave_out: tuple[str, ...] = ()) -> None:
        """Add the keys of a section that are no tuning constants: new ones, and those that are stated."""
        kind = type(model)
        for name, field in kind.model_fields.items():
            owner = next(base for base in reversed(kind.__mro__) if name in inspect.get_annotations(base))
            new = (owner, name) not in self._shown
            if name in leave_out or (is_expert(field) and not self._expert):
                continue
            if not (new or name in model.model_fields_set):
                continue
            self._shown.add((owner, name))
            if new and (text := meanings(owner).get(name)):
                width = 118 - indent
                self.lines += [f"{' ' * indent}# {line}" for line in textwrap.wrap(text, width)]
            self._value(field.alias or name, getattr(model, name), indent)

    def tuning(self, model: BaseModel, indent: int, leave_out: tuple[str, ...] = ()) -> None:
        """Add the tuning constants of a section and of those below it, each once."""
        every = tuple(type(model).model_fields)
        self.keys(model, indent, tuple(n for n in every if not is_expert(type(model).model_fields[n])))
        for name in every:
            value, at = getattr(model, name), len(self.lines)
            parts = value.items() if isinstance(value, dict) else ()
            if name in leave_out or is_expert(type(model).model_fields[name]):
                continue
            if isinstance(value, BaseModel):
                self.tuning(value, indent + 2)
            for part, section in parts:
                before = len(self.lines)
                if isinstance(section, BaseModel):
                    self.tuning(section, indent + 4)
                self._head(before, f"{' ' * indent}  ", part)
            self._head(at, " " * indent, name)

    def _head(self, at: int, begin: str, name: str) -> None:
        """Put a section's name before its lines; as a comment, if all of them are."""
        if below := self.lines[at:]:
            empty = all(line.lstrip().startswith("#") for line in below)
            self.lines.insert(at, f"{begin}{'# ' if empty else ''}{name}:")

    def _value(self, key: str, value: Any, indent: int) -> None:
        begin = " " * indent
        if isinstance(value, BaseModel):
            at = len(self.lines)
            self.keys(value, indent + 2)
            self._head(at, begin, key) if len(self.lines) > at else self.lines.append(f"{begin}# {key}:")
        elif isinstance(value, dict) and value and all(isinstance(item, BaseModel) for item in value.values()):
            self.lines.append(f"{begin}{key}:")
            for name, item in value.items():
                self.lines.append(f"{begin}  {name}:")
                self.keys(item, indent + 4)
        elif isinstance(value, tuple) and value and all(isinstance(item, BaseModel) for item in value):
            self.lines.append(f"{begin}{key}:")
            for item in value:
                at = len(self.lines)
                self.keys(item, indent + 4)
                first = next(i for i in range(at, len(self.lines)) if not self.lines[i].lstrip().startswith("#"))
                self.lines[first] = f"{begin}  - {self.lines[first].lstrip()}"
        elif value is None:
            self.lines.append(f"{begin}# {key}:")
        else:
            plain = yaml.safe_load(_plain(value)) if not isinstance(value, str) else value
            text = yaml.safe_dump(plain, default_flow_style=True, width=10_000).removesuffix("\n...\n").rstrip()
            self.lines.append(f"{begin}{key}: {text}")


def _plain(value: Any) -> str:
    """Return a value as YAML text; sets of numbers, paths and enumerations as their text."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_plain(item)}" for key, item in value.items()) + "}"
    if isinstance(value, tuple | list | frozenset | set):
        return f"[{', '.join(_plain(item) for item in value)}]"
    return yaml.safe_dump(value if isinstance(value, bool | int | float | str) else str(value)).splitlines()[0]


def written() -> str:
    """Return the text of the file."""
    site, file = Site.model_validate(EXAMPLE), SiteFile()
    file.keys(site, 0, ("coarser", "nodes"))
    file.lines += ["# Parameters of each node type; an unknown parameter is an error.", "nodes:"]
    for kind in NODE_TYPES:
        module = importlib.import_module(f"{NODES_MODULE}.{kind}")
        config = module.NODE.config if hasattr(module, "NODE") else module.CONFIG
        set_by_the_graph = [n for n, f in config.model_fields.items() if f.is_required() or n in OWN_PARAMETERS]
        before = len(file.lines)
        file.keys(config.model_construct(), 4, (*set_by_the_graph, "expected", "folders"))
        if len(file.lines) > before:
            file.lines.insert(before, f"  {kind}:")
    expert = SiteFile(expert=True)
    expert.tuning(site, 2, ("nodes",))
    return HEADER + "\n".join(
        [*file.lines, "", "# Tuning constants; a site needs none of them.", "expert:", *expert.lines, ""]
    )


if __name__ == "__main__":
    FILE.write_text(written(), encoding="utf-8")
