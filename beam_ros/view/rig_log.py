"""What happened, in plain words: one entry for every change that a person at the rig would want to know of."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, Literal

Level = Literal["info", "warning", "error"]

STATES = {
    "disconnected": "no connection to the axis",
    "identified": "connected, not homed",
    "homed": "homed, switched off",
    "enabled": "switched on",
    "fault": "fault",
}
ACTIVITIES = {
    "idle": "idle",
    "homing": "looks for home",
    "hold": "holds its place",
    "setpoint": "follows a set-point",
    "armed": "a sequence is loaded",
    "sequence": "a sequence runs",
    "stopping": "decelerates to rest",
}
SEQUENCES = {
    "loading": "is handed over",
    "ready": "is loaded and checked",
    "refused": "was refused",
    "running": "runs",
    "done": "has run to its end",
    "aborted": "was aborted",
    "underrun": "ran dry",
}
"""What the words of ``hub/mode`` and ``hub/sequence_state`` mean."""

_OF_DIAGNOSTICS: dict[str, Level] = {"OK": "info", "WARN": "warning", "ERROR": "error", "STALE": "warning"}


def words_of_mode(mode: Mapping[str, Any]) -> str:
    """Say what ``hub/mode`` means: state and activity, or the fault with its remedy."""
    fault = mode.get("fault")
    if isinstance(fault, Mapping):
        remedy = fault.get("remedy")
        return f"fault: {fault.get('sentence', '')}" + (f"; {remedy}" if remedy else "")
    state, activity = str(mode.get("state", "")), str(mode.get("activity", ""))
    said = STATES.get(state, state)
    if state == "enabled" or activity not in ("idle", ""):
        said += f", {ACTIVITIES.get(activity, activity)}"
    return said


def words_of_sequence(sequence: Mapping[str, Any]) -> str:
    """Say what ``hub/sequence_state`` means."""
    state = str(sequence.get("state", ""))
    reason = sequence.get("reason")
    said = f"sequence {sequence.get('id', '')} {SEQUENCES.get(state, state)}"
    return f"{said}: {reason}" if reason else said


def marked(entry: Mapping[str, Any]) -> str:
    """Return the text of an entry with a mark of its level, for those who see no colour."""
    return {"info": "", "warning": "! ", "error": "!! "}[entry["level"]] + str(entry["text"])


class RigLog:
    """The newest entries, each said once.

    Parameters
    ----------
    length : int -- entries that are kept

    Attributes
    ----------
    total : int -- entries that there were
    epoch : int -- rises whenever the log begins anew
    """

    def __init__(self, length: int = 200) -> None:
        self._entries: deque[dict[str, Any]] = deque(maxlen=length)
        self._last: dict[str, str] = {}
        self.total = self.epoch = 0

    def clear(self) -> None:
        """Begin anew."""
        self._entries.clear()
        self._last.clear()
        self.total, self.epoch = 0, self.epoch + 1

    def add(self, at_s: float, level: Level, text: str) -> None:
        """Add an entry; the time is that of day [s, UNIX]."""
        self._entries.append({"at": round(at_s, 3), "level": level, "text": text})
        self.total += 1

    def change(self, about: str, at_s: float, level: Level, text: str) -> None:
        """Add an entry about something, unless it is what was said of it last."""
        if self._last.get(about) != text:
            self._last[about] = text
            self.add(at_s, level, text)

    def mode(self, at_s: float, mode: Mapping[str, Any]) -> None:
        """Note a change of ``hub/mode``."""
        reason = mode.get("reason")
        text = f"hub: {words_of_mode(mode)}" + (f" ({reason})" if reason and not mode.get("fault") else "")
        self.change("mode", at_s, "error" if mode.get("fault") else "info", text)

    def sequence(self, at_s: float, sequence: Mapping[str, Any]) -> None:
        """Note a change of ``hub/sequence_state``."""
        is_bad = sequence.get("state") in ("refused", "aborted", "underrun")
        self.change("sequence", at_s, "warning" if is_bad else "info", words_of_sequence(sequence))

    def recorder(self, at_s: float, recorder: Mapping[str, Any]) -> None:
        """Note when a recording begins, ends, fails or loses something."""
        path = recorder.get("path")
        if recorder.get("failure"):
            self.change("recorder", at_s, "error", f"recorder: {recorder['failure']}")
        elif recorder.get("recording"):
            self.change("recorder", at_s, "info", f"recording to {path}")
        elif path:
            self.change("recorder", at_s, "info", f"recorded {recorder.get('messages')} messages to {path}")
        if recorder.get("lost"):
            # Once in each recording: the table of losses counts on.
            self.change("recorder lost", at_s, "warning", f"the recorder loses messages of {path}")

    def health(self, at_s: float, node: str, level: str, sentence: str) -> None:
        """Note a node whose level of ``/diagnostics`` changes; what is well from the start needs no words."""
        known = self._last.get(f"level of {node}", "OK")
        self._last[f"level of {node}"] = level
        if level != known:
            text = f"{node} is well again: {sentence}" if level == "OK" else f"{node}: {sentence}"
            self.add(at_s, _OF_DIAGNOSTICS.get(level, "warning"), text)

    def since(self, epoch: int, total: int) -> dict[str, Any]:
        """Return what somebody lacks who has so many entries of an epoch, as ``Trace.since`` does."""
        first = self.total - len(self._entries)
        is_anew = epoch != self.epoch or not first <= total <= self.total
        skipped = 0 if is_anew else total - first
        return {"anew": is_anew, "rows": list(self._entries)[skipped:]}

    def newest(self) -> str:
        """Return the text of the newest entry, empty where there is none."""
        return str(self._entries[-1]["text"]) if self._entries else ""
