"""What the drawing functions need of a label set: class names and colours, and the id of unlabelled pixels."""

from __future__ import annotations

from typing import Any, Protocol

UNLABELLED = 255


class ClassPalette(Protocol):
    """Class names and their RGB colours, indexed by class id; `ltm_core.vision.labels.LabelSet` is one."""

    @property
    def names(self) -> Any: ...

    @property
    def colors(self) -> Any: ...
