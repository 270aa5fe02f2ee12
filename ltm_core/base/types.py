"""Array types by element type, and tables of named columns. Shapes and units are documented where they are used."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import MessageError

BoolArray = NDArray[np.bool_]
UInt8Array = NDArray[np.uint8]
UInt16Array = NDArray[np.uint16]
UInt32Array = NDArray[np.uint32]
Int16Array = NDArray[np.int16]
Int32Array = NDArray[np.int32]
Int64Array = NDArray[np.int64]
IndexArray = NDArray[np.intp]
Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
RgbImage = UInt8Array
"""RGB image, (H, W, 3), 0 to 255."""
RecordArray = NDArray[np.void]
"""Array of a structured dtype."""


Columns = dict[str, NDArray[Any]]


def take(columns: Columns, name: str, dtype: Any, what: str) -> NDArray[Any]:
    """Return the column `name`, which must be there with that dtype. Raises MessageError naming what is there."""
    if name not in columns:
        raise MessageError(f"{what} lacks the field {name!r}; it has {', '.join(columns)}")
    column = columns[name]
    if column.dtype != np.dtype(dtype):
        raise MessageError(f"{what}: field {name!r} is {column.dtype}, must be {np.dtype(dtype)}")
    return column
