"""Bags as other people's recorders leave them, of a beam whose two modes are known in closed form.

The base moves by an acceleration that is held over each millisecond; position and the modes' answers are its exact
solutions. rosbags writes the files, with topics and message types that the suite does not publish itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.linalg import expm

START = 1_750_000_000_000_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
FREQUENCIES_HZ = np.array([6.0, 31.0])
DAMPING_RATIOS = np.array([0.01, 0.006])
RESIDUES = np.array([1.4, -0.5])
"""Of the one height at which laser and accelerometer sit."""


@dataclass(frozen=True)
class Beam:
    """What happened, at every millisecond: base position and acceleration, displacement and acceleration seen."""

    times_s: np.ndarray
    base: np.ndarray
    base_acceleration: np.ndarray
    displacement: np.ndarray
    acceleration: np.ndarray


def shaken(duration_s: float = 8.0, seed: int = 0) -> Beam:
    """Return a beam whose base follows a band of noise, from rest."""
    rng = np.random.default_rng(seed)
    step, n = 1e-3, round(duration_s * 1e3)
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    hz = np.fft.rfftfreq(n, step)
    band = (hz > 1.0) & (hz < 45.0)
    spectrum[band] = np.exp(2j * np.pi * rng.random(np.count_nonzero(band)))
    drive = np.fft.irfft(spectrum, n)
    fade = np.minimum(1.0, np.minimum(np.arange(n), n - 1 - np.arange(n)) / 300.0)
    drive = 0.5 * fade * drive / np.std(drive)
    drive -= np.mean(drive)
    # x = [alpha, alpha', q_1, q_1', ...] under alpha'' held over each step.
    rows = [np.array([[0.0, 1.0], [0.0, 0.0]])]
    rows += [
        np.array([[0.0, 1.0], [-(w**2), -2.0 * z * w]])
        for w, z in zip(2.0 * np.pi * FREQUENCIES_HZ, DAMPING_RATIOS, strict=True)
    ]
    size = 2 * len(rows)
    whole = np.zeros((size + 1, size + 1))
    for k, row in enumerate(rows):
        whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = row
        whole[2 * k + 1, -1] = 1.0 if k == 0 else -RESIDUES[k - 1]
    stepped = expm(whole * step)
    state = np.zeros((n, size))
    for k in range(n - 1):
        state[k + 1] = stepped[:-1, :-1] @ state[k] + stepped[:-1, -1] * drive[k]
    w = state[:, 2::2].sum(axis=1)
    second = sum(
        -RESIDUES[k] * drive
        - (2.0 * np.pi * FREQUENCIES_HZ[k]) ** 2 * state[:, 2 + 2 * k]
        - 2.0 * DAMPING_RATIOS[k] * 2.0 * np.pi * FREQUENCIES_HZ[k] * state[:, 3 + 2 * k]
        for k in range(2)
    )
    return Beam(step * np.arange(n), state[:, 0], drive, state[:, 0] + w, drive + second)


def header(stamp_ns: int, frame: str = "rig") -> Any:
    time = TYPES["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](time, frame)


def joint_state(stamp_ns: int, **positions: float) -> Any:
    return TYPES["sensor_msgs/msg/JointState"](
        header(stamp_ns), list(positions), np.array(list(positions.values())), np.zeros(0), np.zeros(0)
    )


def laser_range(stamp_ns: int, value: float) -> Any:
    return TYPES["sensor_msgs/msg/Range"](header(stamp_ns), 1, 0.01, 0.0, 1.0, np.float32(value), 0.0)


def imu(stamp_ns: int, x: float) -> Any:
    vector = TYPES["geometry_msgs/msg/Vector3"]
    still = TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return TYPES["sensor_msgs/msg/Imu"](
        header(stamp_ns),
        still,
        np.zeros(9),
        vector(0.0, 0.0, 0.0),
        np.zeros(9),
        vector(x, 0.0, 9.81),
        np.zeros(9),
    )


def float64(value: float) -> Any:
    return TYPES["std_msgs/msg/Float64"](value)


Row = tuple[str, int, Any]
"""Topic, receive time [ns], message."""


def write(
    path: Path,
    rows: Iterable[Row],
    storage: StoragePlugin = StoragePlugin.MCAP,
    change: Callable[[Writer], None] = lambda writer: None,
) -> Path:
    """Write messages in the order of their receive times."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for topic, received_ns, message in sorted(rows, key=lambda row: row[1]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            data = STORE.serialize_cdr(message, message.__msgtype__)
            writer.write(connections[topic], received_ns, data)
    return path


def experiment(beam: Beam, namespace: str = "", noise: float = 1e-6, laser_late_s: float = 0.0) -> list[Row]:
    """Return an axis at 1 kHz, a laser at 200 Hz and an accelerometer at 500 Hz."""
    rng = np.random.default_rng(7)
    rows: list[Row] = []
    stamps = [START + round(t * 1e9) for t in beam.times_s]
    for k, stamp in enumerate(stamps):
        received = stamp + 400_000
        rows.append((f"{namespace}/joint_states", received, joint_state(stamp, lift=0.0, axis=beam.base[k])))
        if k % 5 == 0:
            late = stamp + round(laser_late_s * 1e9)
            value = 0.2 + beam.displacement[k] + noise * rng.standard_normal()
            rows.append((f"{namespace}/laser/range", late + 400_000, laser_range(late, value)))
        if k % 2 == 0:
            value = beam.acceleration[k] + 0.02 * rng.standard_normal()
            rows.append((f"{namespace}/imu", received, imu(stamp, value)))
    return rows
