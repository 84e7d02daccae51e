"""Where markers and hub are: ``beam/displacement`` and ``hub/state``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from beam_ros.arrays import FloatArray
from beam_ros.interfaces import graph
from beam_ros.messages.errors import MessageContentError
from beam_ros.messages.message_types import MessageTypes
from beam_ros.messages.stamps import header, stamp_ns


@dataclass(frozen=True)
class Displacement:
    """What ``beam/displacement`` says at one instant.

    Attributes
    ----------
    stamp_ns : int -- instant [ns, UNIX]
    names : tuple of str -- markers, ``z010`` ..
    positions : ndarray, shape (n_markers,) -- absolute displacement u [m], NaN where not seen
    """

    stamp_ns: int
    names: tuple[str, ...]
    positions: FloatArray


def displacement(types: MessageTypes, stamp_ns: int, names: Sequence[str], positions: ArrayLike) -> Any:
    """Build the JointState of ``beam/displacement``: u [m] of each marker, NaN where it was not seen."""
    values = np.asarray(positions, dtype=np.float64)
    if values.shape != (len(names),):
        raise MessageContentError(
            f"displacement of shape {values.shape} for {len(names)} markers: expected one number for each"
        )
    return _joint_state(types, stamp_ns, names, values, (), ())


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
    for stamp in sorted(set(stamps_ns)):
        chosen = [k for k, at_ns in enumerate(stamps_ns) if at_ns == stamp]
        yield stamp, displacement(types, stamp, [names[k] for k in chosen], x_m[chosen])


def read_displacement(message: Any) -> Displacement:
    """Read a message of ``beam/displacement``.

    Raises
    ------
    MessageContentError
        There is not one position for each name, or a name comes twice.
    """
    names = tuple(message.name)
    positions = np.array(message.position, dtype=np.float64)
    if len(positions) != len(names) or len(set(names)) != len(names) or not names:
        raise MessageContentError(
            f"displacement with {len(positions)} positions for the names {list(names)}: expected one "
            "position for each of at least one name, and no name twice"
        )
    return Displacement(stamp_ns(message), names, positions)


@dataclass(frozen=True)
class HubSample:
    """What ``hub/state`` says: stamp [ns, UNIX], position [m], velocity [m/s], effort [N]; NaN: not known."""

    stamp_ns: int
    position: float
    velocity: float = math.nan
    effort: float = math.nan


def hub_state(types: MessageTypes, sample: HubSample) -> Any:
    """Build the JointState of ``hub/state``; a velocity or effort of NaN is left out."""
    optional = [() if math.isnan(value) else (value,) for value in (sample.velocity, sample.effort)]
    return _joint_state(types, sample.stamp_ns, (graph.HUB_JOINT,), (sample.position,), *optional)


def read_hub_state(message: Any) -> HubSample:
    """Read a message of ``hub/state``.

    Raises
    ------
    MessageContentError
        It does not hold exactly one joint with a position.
    """
    if len(message.name) != 1 or len(message.position) != 1:
        raise MessageContentError(
            f"hub state with joints {list(message.name)} and {len(message.position)} positions: expected one "
            f"joint `{graph.HUB_JOINT}` with a position"
        )
    velocity, effort = (float(v[0]) if len(v) else math.nan for v in (message.velocity, message.effort))
    return HubSample(stamp_ns(message), float(message.position[0]), velocity, effort)


def _joint_state(
    types: MessageTypes,
    stamp_ns: int,
    names: Sequence[str],
    positions: ArrayLike,
    velocities: ArrayLike,
    efforts: ArrayLike,
) -> Any:
    return types.make(
        graph.JOINT_STATE,
        header=header(types, stamp_ns, graph.RIG_FRAME),
        name=list(names),
        position=types.floats(positions),
        velocity=types.floats(velocities),
        effort=types.floats(efforts),
    )
