"""The camera's frames, as they are and compressed, and what it is: ``camera/camera_info``."""

from __future__ import annotations

from typing import Any

import numpy as np

from beam_ros.arrays import ByteArray
from beam_ros.interfaces import graph
from beam_ros.messages.message_types import MessageTypes
from beam_ros.messages.stamps import header


def image(types: MessageTypes, stamp_ns: int, pixels: ByteArray) -> Any:
    """Build an Image from pixels: mono8 of shape (height, width), bgr8 of shape (height, width, 3)."""
    height, width = pixels.shape[:2]
    return types.make(
        "sensor_msgs/msg/Image",
        header=header(types, stamp_ns, graph.CAMERA_FRAME),
        height=height,
        width=width,
        encoding="mono8" if pixels.ndim == 2 else "bgr8",
        is_bigendian=0,
        step=pixels.nbytes // height,
        data=types.octets(pixels.tobytes()),
    )


def compressed_image(types: MessageTypes, stamp_ns: int, jpeg: bytes) -> Any:
    """Build a CompressedImage from a grey JPEG."""
    return types.make(
        "sensor_msgs/msg/CompressedImage",
        header=header(types, stamp_ns, graph.CAMERA_FRAME),
        format="mono8; jpeg compressed mono8",
        data=types.octets(jpeg),
    )


def camera_info(types: MessageTypes, stamp_ns: int, width: int, height: int) -> Any:
    """Build the CameraInfo of an uncalibrated camera: size and, by convention, a K of zeros."""
    return types.make(
        "sensor_msgs/msg/CameraInfo",
        header=header(types, stamp_ns, graph.CAMERA_FRAME),
        height=height,
        width=width,
        distortion_model="plumb_bob",
        d=types.floats(np.zeros(5)),
        k=np.zeros(9),
        r=np.eye(3).ravel(),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=types.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        ),
    )
