"""Array types by element type. Shapes and units are documented where an array is used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
