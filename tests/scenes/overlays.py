"""Twelve kinds of bars, frames, captions and logos drawn onto a photo."""

from collections.abc import Callable

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, UInt8Array

Drawn = tuple[UInt8Array, BoolArray]
"""The photo (H, W, 3) with an overlay, and (H, W) bool where it lies."""
Color = tuple[int, int, int]
WHITE: Color = (255, 255, 255)


def _write(photo: UInt8Array, text: str, left: int, base: int, tall: float, color: Color) -> None:
    cv2.putText(photo, text, (left, base), cv2.FONT_HERSHEY_SIMPLEX, tall / 30, color, max(1, round(tall / 14)))


def _bar(edge: str, share: float, color: Color, ink: Color | None = None) -> Callable[[UInt8Array], Drawn]:
    def draw(photo: UInt8Array) -> Drawn:
        turns = ["top", "right", "bottom", "left"].index(edge)
        turned = np.rot90(photo, turns).copy()
        thick = round(share * len(turned))
        turned[:thick] = color
        if ink is not None:
            _write(turned, "North Peak 2021-07-04 13:05:11 UTC", 8, round(0.75 * thick), 0.6 * thick, ink)
        hidden = np.zeros(turned.shape[:2], np.bool_)
        hidden[:thick] = True
        return np.ascontiguousarray(np.rot90(turned, -turns)), np.rot90(hidden, -turns)

    return draw


def _both(*draws: Callable[[UInt8Array], Drawn]) -> Callable[[UInt8Array], Drawn]:
    def draw(photo: UInt8Array) -> Drawn:
        hidden = np.zeros(photo.shape[:2], np.bool_)
        for one in draws:
            photo, more = one(photo)
            hidden = hidden | more
        return photo, hidden

    return draw


def _boxed(photo: UInt8Array, shown: UInt8Array, top: float, left: float, tall: float, wide: float) -> Drawn:
    height, width = photo.shape[:2]
    rows = slice(round(top * height), round((top + tall) * height))
    columns = slice(round(left * width), round((left + wide) * width))
    photo, hidden = photo.copy(), np.zeros((height, width), np.bool_)
    size = columns.stop - columns.start, rows.stop - rows.start
    photo[rows, columns] = cv2.resize(shown, size, interpolation=cv2.INTER_AREA)
    hidden[rows.start - 2 : rows.stop + 2, columns.start - 2 : columns.stop + 2] = True
    return photo, hidden


def _logo(photo: UInt8Array) -> Drawn:
    shown = np.full((60, 100, 3), (200, 30, 40), np.uint8)
    cv2.circle(shown, (50, 30), 20, WHITE, -1)
    return _boxed(photo, shown, 0.86, 0.86, 0.12, 0.12)


def _inset(photo: UInt8Array) -> Drawn:
    shown = cv2.copyMakeBorder(photo, *[len(photo) // 40] * 4, cv2.BORDER_CONSTANT, value=WHITE)
    return _boxed(photo, np.asarray(shown, np.uint8), 0.03, 0.72, 0.25, 0.25)


def _timestamp(photo: UInt8Array) -> Drawn:
    height, width = photo.shape[:2]
    photo, hidden = photo.copy(), np.zeros((height, width), np.bool_)
    _write(photo, "2021-07-04 13:05:11 NORTH", round(0.03 * width), round(0.08 * height), 0.05 * height, WHITE)
    hidden[round(0.03 * height) : round(0.1 * height), round(0.02 * width) : round(0.8 * width)] = True
    return photo, hidden


def _half_transparent(photo: UInt8Array) -> Drawn:
    drawn, hidden = _bar("bottom", 0.05, (0, 0, 0), WHITE)(photo)
    return np.where(hidden[..., None], (photo // 2 + drawn // 2).astype(np.uint8), photo), hidden


FRAMES: dict[str, Callable[[UInt8Array], Drawn]] = {
    "black above": _bar("top", 0.04, (0, 0, 0)),
    "white below": _bar("bottom", 0.05, WHITE, (0, 0, 0)),
    "blue above": _bar("top", 0.05, (20, 60, 150), (255, 255, 0)),
    "green below": _bar("bottom", 0.05, (40, 120, 60), WHITE),
    "grey beside": _bar("right", 0.06, (30, 30, 30), WHITE),
    "letterbox": _both(_bar("top", 0.05, (0, 0, 0)), _bar("bottom", 0.05, (0, 0, 0))),
    "pillarbox": _both(_bar("left", 0.06, (0, 0, 0)), _bar("right", 0.06, (0, 0, 0))),
}
"""Overlays that are detected without a mask."""
MASKED: dict[str, Callable[[UInt8Array], Drawn]] = {
    "half transparent": _half_transparent,
    "timestamp": _timestamp,
    "logo": _logo,
    "picture in picture": _inset,
}
"""Overlays for which a mask is given."""
