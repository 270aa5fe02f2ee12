"""Reads and writes the masks of fixed cameras as PNG."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from ltm_core.errors import ConfigError, ImageError
from ltm_core.picture_io import open_picture
from ltm_core.types import BoolArray
from ltm_core.vision.camera_mask import CameraMask


def read_mask(path: Path, place: str) -> CameraMask:
    """A PNG of one channel in which all but 0 is masked. `place`: the key that names it, for errors.

    Raises ConfigError: no such picture, another format, colours or an alpha channel, nothing or everything masked.
    """
    try:
        with open_picture(path) as (source, _):
            if source.format != "PNG":
                raise ConfigError(f"{place}: {path} is a {source.format}, whose edges are not sharp; save it as PNG")
            if source.mode not in ("1", "L", "P", "I", "I;16"):
                raise ConfigError(
                    f"{place}: {path} has colours or transparency ({source.mode}); a mask is a PNG of one channel, "
                    "0 where the landscape is seen"
                )
            hidden = np.asarray(source) != 0
    except ImageError as error:
        raise ConfigError(f"{place}: {error}") from error
    return CameraMask(hidden, f"{place}: {path}")


def write_mask(path: Path, hidden: BoolArray) -> None:
    """Write (H, W) bool as a PNG that `read_mask` takes: 255 where masked."""
    Image.fromarray(np.where(hidden, 255, 0).astype(np.uint8)).save(path, "PNG", optimize=True)
