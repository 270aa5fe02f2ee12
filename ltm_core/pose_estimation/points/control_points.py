"""Ground control points: surveyed map positions with their marked pixels in an image, or in those of a head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array


@dataclass(frozen=True, eq=False)
class ControlPoints:
    """Surveyed points.

    `names`: (N,). `places`: (N, 3) map metres. `pixels`: (N, 2) u, v with (0, 0) the centre of the top-left pixel.
    Raises PoseError that names points without finite values and points that are given twice.
    """

    names: tuple[str, ...]
    places: Float64Array
    pixels: Float64Array

    def __post_init__(self) -> None:
        places, pixels = np.array(self.places, np.float64), np.array(self.pixels, np.float64)
        count = len(self.names)
        if places.shape != (count, 3) or pixels.shape != (count, 2):
            raise PoseError(
                f"{count} control points need places ({count}, 3) and pixels ({count}, 2), got {places.shape}, "
                f"{pixels.shape}"
            )
        bad = ~(np.isfinite(places).all(axis=1) & np.isfinite(pixels).all(axis=1))
        if bad.any():
            raise PoseError(f"control points without finite coordinates: {', '.join(np.array(self.names)[bad])}")
        for what, keys in (
            ("name", self.names),
            ("place on the map", tuple(map(tuple, places.tolist()))),
            ("pixel", tuple(map(tuple, pixels.tolist()))),
        ):
            twice = [name for name, key in zip(self.names, keys, strict=True) if keys.count(key) > 1]
            if twice:
                raise PoseError(f"control points with the same {what}: {', '.join(twice)}; keep one of each")
        places.flags.writeable = pixels.flags.writeable = False
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "pixels", pixels)


@dataclass(frozen=True, eq=False)
class PtzPoints:
    """Landmarks in images of a head. `names`: (N,); `places`: (N, 3) map metres; `pixels`: (N, 2), (0, 0) the centre
    of the top-left pixel; `readings`: (N, 3) pan (deg), tilt (deg) and zoom of each one's image."""

    names: tuple[str, ...]
    places: Float64Array
    pixels: Float64Array
    readings: Float64Array

    def __post_init__(self) -> None:
        count = len(self.names)
        shapes = {"places": (count, 3), "pixels": (count, 2), "readings": (count, 3)}
        for what, shape in shapes.items():
            values = np.array(getattr(self, what), np.float64)
            if values.shape != shape:
                raise PoseError(f"{count} landmarks need {what} {shape}, got {values.shape}")
            if not np.isfinite(values).all():
                bad = np.array(self.names)[~np.isfinite(values).all(axis=1)]
                raise PoseError(f"landmarks without finite {what}: {', '.join(bad)}")
            values.flags.writeable = False
            object.__setattr__(self, what, values)
