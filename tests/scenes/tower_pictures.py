"""Pictures of a tower's camera as they are drawn here: sky with other clouds each time, hills, a lens's dark corners, a
caption whose time runs, and a lattice mast."""

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ltm_core.base.types import BoolArray, UInt8Array

WIDTH, HEIGHT = 800, 520
HORIZON = 300
MAST = (610, 60, 660, 330)
"""Left, top, right, bottom."""
LENS = (396.0, 262.0, 425.0)
"""Middle (u, v) and radius: seen is what lies within."""


def corners() -> BoolArray:
    """(H, W): what the hood covers."""
    rows, cols = np.mgrid[0:HEIGHT, 0:WIDTH]
    return np.asarray(np.hypot(cols - LENS[0], rows - LENS[1]) > LENS[2])


def tower_picture(
    seed: int, mast: bool = True, hood: bool = True, caption: str = "20180728.142706 Ridge West, a fire watch"
) -> UInt8Array:
    """(H, W, 3) RGB; `seed`: of clouds, light and noise. The hills are the same each time."""
    rng, hills = np.random.default_rng(seed), np.random.default_rng(5)
    rows, cols = np.mgrid[0:HEIGHT, 0:WIDTH]
    picture = np.array([95.0, 140.0, 205.0]) + rows[..., None] * np.array([0.25, 0.18, 0.08])
    clouds = cv2.GaussianBlur(rng.normal(0.0, 1.0, (HEIGHT, WIDTH)), (0, 0), 22.0)
    picture += np.clip(clouds / clouds.std() - 0.6, 0.0, 1.0)[..., None] * 70.0
    ridge = HORIZON + 18 * np.sin(cols / 130.0) + 7 * np.sin(cols / 37.0)
    texture = hills.normal(0.0, 1.0, (HEIGHT, WIDTH))
    texture = cv2.GaussianBlur(texture, (0, 0), 1.6) * 4.0
    picture = np.where((rows > ridge)[..., None], np.array([96.0, 92.0, 60.0]) + 16.0 * texture[..., None], picture)
    drawn = np.clip(picture * rng.uniform(0.85, 1.1), 0, 255).astype(np.uint8)
    if mast:
        left, top, right, bottom = MAST
        for u in (left, right):
            cv2.line(drawn, (u, top), (u, bottom), (52, 54, 60), 4)
        for v in range(top, bottom - 20, 26):
            cv2.line(drawn, (left, v), (right, v + 26), (52, 54, 60), 3)
            cv2.line(drawn, (right, v), (left, v + 26), (52, 54, 60), 3)
    if hood:
        drawn[corners()] = (22, 20, 17)
        drawn = np.asarray(cv2.GaussianBlur(drawn, (0, 0), 1.0), np.uint8)
    drawn = np.clip(drawn + rng.normal(0.0, 2.0, drawn.shape), 0, 255).astype(np.uint8)
    if not caption:
        return drawn
    canvas = Image.fromarray(drawn)
    text = caption.replace("142706", f"14{seed % 60:02d}06")
    ImageDraw.Draw(canvas).text((120, 5), text, fill=(240, 230, 70), font=ImageFont.load_default(15))
    return np.asarray(canvas, np.uint8)
