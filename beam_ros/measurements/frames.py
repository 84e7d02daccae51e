"""What is published of a measured frame.

``beam/displacement`` carries the middle of each row's exposure, ``beam/markers`` the frame's own stamp, by which it
finds its image.

The tracker's node, ``beam track`` and ``beam simulate`` say it in the same words.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from beam_ros import messages
from beam_ros.arrays import FloatArray
from beam_ros.messages import MessageTypes


def displacement_messages(
    types: MessageTypes, names: Sequence[str], stamps_ns: Sequence[int], x_m: FloatArray
) -> Iterator[tuple[int, Any]]:
    """Yield a message of ``beam/displacement`` for every instant at which markers were exposed.

    Parameters
    ----------
    types : MessageTypes
    names : sequence of str, length m
    stamps_ns : sequence of int, length m -- middle of the exposure of each marker's row [ns, UNIX]
    x_m : ndarray, shape (m,) -- u of each marker [m]; NaN where it was not seen

    Yields
    ------
    stamp_ns : int -- [ns, UNIX], rising
    message : JointState
    """
    for stamp_ns in sorted(set(stamps_ns)):
        chosen = [k for k, stamp in enumerate(stamps_ns) if stamp == stamp_ns]
        yield stamp_ns, messages.displacement(types, stamp_ns, [names[k] for k in chosen], x_m[chosen])


def markers_message(
    types: MessageTypes,
    stamp_ns: int,
    heights_m: ArrayLike,
    x_m: FloatArray,
    sigma_m: FloatArray,
    u_px: FloatArray,
    v_px: FloatArray,
) -> Any:
    """Build the PointCloud2 of ``beam/markers``.

    Parameters
    ----------
    types : MessageTypes
    stamp_ns : int -- of the frame [ns, UNIX]
    heights_m : array_like, shape (m,) -- above the clamp [m]
    x_m, sigma_m : ndarray, shape (m,) -- displacement and its standard deviation [m]
    u_px, v_px : ndarray, shape (m,) -- position in the image as it is; NaN where not seen [px]
    """
    rows = np.zeros(len(u_px), dtype=messages.MARKER_DTYPE)
    rows["x"], rows["z"] = x_m, heights_m
    rows["x_m"], rows["sigma_m"] = x_m, sigma_m
    rows["u"], rows["v"] = u_px, v_px
    rows["id"] = np.arange(len(u_px))
    rows["valid"] = np.isfinite(u_px)
    return messages.marker_cloud(types, messages.MarkerCloud(stamp_ns, rows))
