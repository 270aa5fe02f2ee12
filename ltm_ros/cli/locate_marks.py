"""What `ltm locate` is given of pictures: marks, and masks over them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ltm_core.errors import ConfigError
from ltm_core.locating.locating_io import read_mask
from ltm_core.locating.region import marked_box, marked_pixel, marked_polygon
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.types import BoolArray
from ltm_ros.cli.locate_cameras import LocatingScene
from ltm_ros.cli.number_lists import numbers


def hidden_by(scene: LocatingScene, given: list[str]) -> dict[str, BoolArray | None]:
    """Of each camera, (H, W): what its site file hides, and what is given besides as NAME=PNG. Raises ConfigError."""
    found = {name: camera.hidden for name, camera in scene.cameras.items()}
    for text in given:
        name, equals, path = text.partition("=")
        if not equals:
            raise ConfigError(f"--mask {text!r}: name its camera: --mask north=mast.png")
        more, hidden = read_mask(Path(path), scene.camera(name).camera), found[name]
        found[name] = more if hidden is None else more | hidden
    return found


def marked(
    scene: LocatingScene,
    name: str,
    text: str,
    config: LocatingConfig,
    smoke: bool,
    masks: dict[str, BoolArray | None],
) -> Sighting:
    """A mark in a camera's picture: a pixel, a box or a polygon, by how many numbers it has. Raises ConfigError."""
    camera = scene.camera(name)
    values = numbers(text, "a mark")
    mask = masks.get(name)
    if len(values) == 2:
        mark = marked_pixel(camera.camera, values, config.pixel_sigma, mask)
    elif len(values) == 4:
        mark = marked_box(camera.camera, values, config.pixel_sigma, config.box_sigma, smoke, mask)
    elif len(values) % 2 == 0:
        outline = np.array(values).reshape(-1, 2)
        mark = marked_polygon(camera.camera, outline, config.pixel_sigma, config.box_sigma, smoke, mask)
    else:
        raise ConfigError(f"a mark is u,v, or u_min,v_min,u_max,v_max, or three or more points u,v; got {text!r}")
    return Sighting(name, camera.camera, camera.pose, camera.covariance, mark)
