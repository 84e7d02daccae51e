"""Strings that carry JSON, such as ``hub/sequence_state``, and texts that carry named numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from beam_ros.hub.contract import HubStatus, SequenceReport
from beam_ros.hub.faults import NO_FAULT
from beam_ros.interfaces import graph
from beam_ros.messages.errors import MessageContentError
from beam_ros.messages.message_types import MessageTypes
from beam_ros.process.strict_json import strict_json

_KEY_VALUES = re.compile(r"(\w+)=(-?\d+)")


def json_text(types: MessageTypes, content: Mapping[str, Any]) -> Any:
    """Build a String that carries JSON; NaN and infinities, which JSON does not know, become null."""
    return types.make(graph.STRING, data=strict_json(content))


def sequence_state(types: MessageTypes, report: SequenceReport) -> Any:
    """Build the String of ``hub/sequence_state``."""
    content = {
        "id": report.sequence_id,
        "state": report.state,
        "points": report.points,
        "reason": report.reason,
        "late": report.is_late,
    }
    return json_text(types, content)


def hub_mode(types: MessageTypes, status: HubStatus, since_ns: int) -> Any:
    """Build the String of ``hub/mode``.

    Parameters
    ----------
    types : MessageTypes
    status : HubStatus
    since_ns : int -- when the hub came into this state, activity or fault [ns, UNIX]
    """
    fault = None
    if status.fault is not NO_FAULT:
        fault = {name: getattr(status.fault, name) for name in ("number", "name", "sentence")}
        fault["remedy"] = status.remedy
    content = {
        "state": status.state,
        "activity": status.activity,
        "fault": fault,
        "since": round(since_ns * 1e-9, 6),
        "reason": status.reason,
    }
    return json_text(types, content)


def read_json(message: Any) -> dict[str, Any]:
    """Read a String that carries a JSON object.

    Raises
    ------
    MessageContentError
        The text is no JSON object.
    """
    try:
        content = json.loads(message.data)
    except (ValueError, RecursionError) as err:
        raise MessageContentError(f"text {message.data[:80]!r} is no JSON ({err})") from err
    if not isinstance(content, dict):
        raise MessageContentError(f"text {message.data[:80]!r}: expected a JSON object {{..}}")
    return content


def key_values(text: str) -> dict[str, int]:
    """Return the whole numbers of a text such as ``epoch=3 period_ns=1000000``, by their names."""
    return {name: int(value) for name, value in _KEY_VALUES.findall(text)}
