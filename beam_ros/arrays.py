"""The aliases for arrays that all annotations use; shapes and units stand in the docstrings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]
Int32Array = NDArray[np.int32]
ByteArray = NDArray[np.uint8]
StructuredArray = NDArray[np.void]
StampArray = NDArray[np.int64]
"""Stamps [ns]."""
ImageArray = NDArray[Any]
"""Grey values of one picture, shape (height, width)."""
