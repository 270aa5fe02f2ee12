"""Array types of the pictures package, and what it asks of a label set."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Rgb = NDArray[np.uint8]
Floats = NDArray[np.float32]
Labels = NDArray[np.uint8]

UNLABELLED = 255


class Palette(Protocol):
    """Class names and their RGB colours, indexed by class id; `ltm_core.vision.labels.LabelSet` is one."""

    @property
    def names(self) -> Any: ...

    @property
    def colors(self) -> Any: ...
