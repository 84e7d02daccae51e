"""How the nodes are: ``/diagnostics``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from beam_ros.messages.message_types import MessageTypes
from beam_ros.messages.stamps import header

LEVELS = ("OK", "WARN", "ERROR", "STALE")


@dataclass(frozen=True)
class Health:
    """One status of ``/diagnostics``: who, level (OK, WARN, ERROR, STALE), a sentence, and values."""

    name: str
    level: str
    message: str
    hardware_id: str = ""
    values: Mapping[str, object] = field(default_factory=dict)


def diagnostics(types: MessageTypes, stamp_ns: int, statuses: Iterable[Health]) -> Any:
    """Build the DiagnosticArray of ``/diagnostics``."""
    return types.make(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=header(types, stamp_ns, ""),
        status=[
            types.make(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=types.octet(LEVELS.index(status.level)),
                name=status.name,
                message=status.message,
                hardware_id=status.hardware_id,
                values=[
                    types.make("diagnostic_msgs/msg/KeyValue", key=str(key), value=str(value))
                    for key, value in status.values.items()
                ],
            )
            for status in statuses
        ],
    )


def read_diagnostics(message: Any) -> tuple[Health, ...]:
    """Read a message of ``/diagnostics``; a level outside OK..STALE counts as STALE."""
    return tuple(
        Health(
            status.name,
            LEVELS[min(_octet_value(status.level), len(LEVELS) - 1)],
            status.message,
            status.hardware_id,
            {item.key: item.value for item in status.values},
        )
        for status in message.status
    )


def _octet_value(level: Any) -> int:
    return level[0] if isinstance(level, bytes) else int(level)
