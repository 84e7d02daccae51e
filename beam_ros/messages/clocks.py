"""The device's clock against the host's: ``hub/clock_sync``."""

from __future__ import annotations

from typing import Any

from beam_ros.hub.contract import ClockSync
from beam_ros.messages.errors import MessageContentError
from beam_ros.messages.message_types import MessageTypes
from beam_ros.messages.stamps import header, ros_time, stamp_ns, time_ns
from beam_ros.messages.texts import key_values


def clock_sync(types: MessageTypes, sync: ClockSync) -> Any:
    """Build the TimeReference of ``hub/clock_sync``."""
    return types.make(
        "sensor_msgs/msg/TimeReference",
        header=header(types, sync.host_ns, ""),
        time_ref=ros_time(types, sync.device_ns),
        source=f"epoch={sync.epoch} rtt_ns={sync.rtt_ns}",
    )


def read_clock_sync(message: Any) -> ClockSync:
    """Read a message of ``hub/clock_sync``.

    Raises
    ------
    MessageContentError
        Its source does not name epoch and round trip.
    """
    values = key_values(message.source)
    if not {"epoch", "rtt_ns"} <= set(values):
        raise MessageContentError(
            f"clock sync with source {message.source[:80]!r}: expected 'epoch=<n> rtt_ns=<n>'"
        )
    device_ns = time_ns(message.time_ref)
    return ClockSync(stamp_ns(message), device_ns, values["epoch"], values["rtt_ns"])
