"""Where message classes come from, and how they hold numbers: rclpy's for the wire, those of rosbags for bags.

Neither is imported before it is asked for.
"""

from __future__ import annotations

import array
import functools
import importlib
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from beam_ros.arrays import ByteArray, FloatArray
from beam_ros.errors import RosMissingError


class MessageTypes(Protocol):
    """Where message classes come from and how they hold numbers."""

    def make(self, type_name: str, **fields: Any) -> Any:
        """Build a message of type "package/msg/Name" from all of its fields."""

    def floats(self, values: ArrayLike) -> Any:
        """Hold numbers as a ``float64[]`` field wants them."""

    def octets(self, values: bytes) -> Any:
        """Hold bytes as a ``uint8[]`` field wants them."""

    def octet(self, value: int) -> Any:
        """Hold one byte as a ``byte`` field wants it."""


class RosTypes:
    """The message classes of rclpy, imported when first asked for."""

    def __init__(self) -> None:
        self._classes: dict[str, Any] = {}

    def message_class(self, type_name: str) -> Any:
        """Return rclpy's class of a message type, "package/msg/Name".

        Raises
        ------
        RosMissingError
            ROS 2, or this message package, is not installed.
        """
        if type_name not in self._classes:
            package, kind, name = type_name.split("/")
            try:
                self._classes[type_name] = getattr(importlib.import_module(f"{package}.{kind}"), name)
            except (ImportError, AttributeError) as err:
                raise RosMissingError(
                    f"ROS 2 type {type_name} cannot be loaded ({err}); expected ROS 2 Jazzy with its common "
                    "interfaces; source it, or install this package with its `ros` extra"
                ) from err
        return self._classes[type_name]

    def service_class(self, type_name: str) -> Any:
        """Return rclpy's class of a service type, "package/srv/Name"."""
        return self.message_class(type_name)

    def make(self, type_name: str, **fields: Any) -> Any:
        """Build a message of type "package/msg/Name" from its fields."""
        return self.message_class(type_name)(**fields)

    def floats(self, values: ArrayLike) -> array.array[float]:
        """Hold numbers in the array that rclpy takes over without checking each."""
        return array.array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())

    def octets(self, values: bytes) -> array.array[int]:
        """Hold bytes in the array that rclpy takes over without checking each."""
        return array.array("B", values)

    def octet(self, value: int) -> bytes:
        """Hold one byte as rclpy does: as bytes of length 1."""
        return bytes([value])


class BagTypes:
    """The message classes of rosbags for ROS 2 Jazzy, with their CDR serialisation."""

    def __init__(self) -> None:
        self.store = _jazzy_typestore()

    def make(self, type_name: str, **fields: Any) -> Any:
        """Build a message of type "package/msg/Name" from all of its fields."""
        return self.store.types[type_name](**fields)

    def floats(self, values: ArrayLike) -> FloatArray:
        """Hold numbers as an array of float64."""
        return np.ascontiguousarray(values, dtype=np.float64)

    def octets(self, values: bytes) -> ByteArray:
        """Hold bytes as an array of uint8."""
        return np.frombuffer(values, dtype=np.uint8)

    def octet(self, value: int) -> int:
        """Hold one byte as a number."""
        return value

    def serialize(self, message: Any, type_name: str) -> bytes:
        """Return a message's CDR bytes, as they travel on the wire."""
        return bytes(self.store.serialize_cdr(message, type_name))

    def deserialize(self, data: bytes, type_name: str) -> Any:
        """Return the message that CDR bytes hold."""
        return self.store.deserialize_cdr(data, type_name)


@functools.lru_cache(maxsize=1)
def _jazzy_typestore() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)
