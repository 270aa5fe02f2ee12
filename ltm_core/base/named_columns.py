"""Named columns of equal length, the transport format of tables of cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import MessageError

Columns = dict[str, NDArray[Any]]


def take(columns: Columns, name: str, dtype: Any, what: str) -> NDArray[Any]:
    """Return the column `name`, which must be there with that dtype. Raises MessageError naming what is there."""
    if name not in columns:
        raise MessageError(f"{what} lacks the field {name!r}; it has {', '.join(columns)}")
    column = columns[name]
    if column.dtype != np.dtype(dtype):
        raise MessageError(f"{what}: field {name!r} is {column.dtype}, must be {np.dtype(dtype)}")
    return column
