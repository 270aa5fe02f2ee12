"""What a person says of a whole photo: classes that are nowhere in it, and the height below which there is no sky.

Ten seconds of looking teach every pixel of a photo, where areas teach some. A statement is the names of absent classes,
and `sky:36` for no sky below 36 % of the height: `water shrub sky:36`. As a label to train on it is `_BASE` plus a bit
for each absent class.
"""

from typing import Final

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.vision.labels import Label

_BASE: Final = 100


def rows_of(statement: str, height: int) -> UInt8Array:
    """Return the label of each row of a photo of this height. Raises ConfigError for a class that does not exist."""
    classes = np.zeros(height, np.uint8)
    for word in statement.split():
        name, _, percent = word.partition(":")
        if name.upper() not in Label.__members__ or not (percent or "0").isdigit():
            known = ", ".join(label.name.lower() for label in Label)
            raise ConfigError(f"statement {statement!r}: {word!r} is no class; classes: {known}; or sky:PERCENT")
        classes[-(-height * int(percent or 0) // 100) :] |= np.uint8(1 << Label[name.upper()])
    return classes + np.uint8(_BASE)


def stated(labels: UInt8Array) -> BoolArray:
    """Return where labels are statements."""
    return np.asarray((labels >= _BASE) & (labels < _BASE + (1 << len(Label))))


def absent(label: int) -> tuple[Label, ...]:
    """Return the classes that a statement excludes."""
    return tuple(k for k in Label if (label - _BASE) >> k & 1)
