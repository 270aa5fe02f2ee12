"""The small site with masks: a mast from the sky down to the ground, as a PNG, and polygons on the camera that pans."""

from pathlib import Path

import numpy as np
import yaml

from ltm_core.base.types import BoolArray
from ltm_core.vision.masks import write_mask
from scenes.networks import write_depth_network
from scenes.small_site import MAST, TOWER, SmallSite


def hidden_of(camera: str) -> BoolArray:
    """(H, W): what the masks of `write_masked_site` hide."""
    shape = (MAST.height, MAST.width) if camera == "mast" else (TOWER.height, TOWER.width)
    hidden = np.zeros(shape, np.bool_)
    if camera == "mast":
        hidden[:, 90:131] = True
    else:
        hidden[100:180, 40:200] = True
    return hidden


def write_masked_site(small: SmallSite, name: str = "masked.yaml") -> Path:
    """A site file beside that of `small`: with masks and a depth network, so that all of the camera's nodes run."""
    write_depth_network(small.folder)
    content = yaml.safe_load(small.path.read_text()) | {"depth_model": "depth.yaml", "terrain": {}}
    write_mask(small.folder / "mast_mask.png", hidden_of("mast"))
    content["cameras"]["mast"]["mask"] = "mast_mask.png"
    content["cameras"]["tower"]["mask"] = [
        {"class": "dish", "polygon": [[40, 100], [199, 100], [199, 179], [40, 179]], "reason": "in front of the lens"}
    ]
    path = small.folder / name
    path.write_text(yaml.safe_dump(content))
    return path


VIEW = 2
"""Number of the tower's frame that the mask of `write_turning_site` belongs to."""


def hidden_of_view() -> BoolArray:
    """(H, W): what the mask of the tower's view hides."""
    hidden = np.zeros((TOWER.height, TOWER.width), np.bool_)
    hidden[90:170, 150:290] = True
    return hidden


def write_turning_site(small: SmallSite, name: str = "turning.yaml") -> Path:
    """A site file beside that of `small` whose tower has a mask where it looks as in its frame VIEW, and none else."""
    content = yaml.safe_load(small.path.read_text())
    azimuth, pitch, _ = small.tower_pose(20.0 * VIEW).angles_deg
    write_mask(small.folder / "view_mask.png", hidden_of_view())
    content["cameras"]["tower"]["view_masks"] = [
        {"name": "forty", "azimuth_deg": azimuth + 0.3, "pitch_deg": pitch, "mask": "view_mask.png"}
    ]
    path = small.folder / name
    path.write_text(yaml.safe_dump(content))
    return path
