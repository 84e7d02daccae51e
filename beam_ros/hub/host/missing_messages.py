"""Whether a kind of message has stopped while others go on."""

from __future__ import annotations

from beam_ros.hub.parameters import AxisParameters

MISSING_NS = 400_000_000
"""Other messages come for so long, and what is missing does not: then it has stopped."""
AWAITED = ("telemetry", "status")


class MissingMessages:
    """Since when telemetry and status have not come, though something came.

    Parameters
    ----------
    parameters : AxisParameters
        How often telemetry comes.
    """

    def __init__(self, parameters: AxisParameters) -> None:
        self._most_ns = max(MISSING_NS, 4 * parameters.batch_ns)
        self._since_ns: dict[str, int] = {}

    def forget(self) -> None:
        """Begin anew."""
        self._since_ns.clear()

    def hear(self, kind: str, now_ns: int) -> tuple[str, str] | None:
        """Take note of a message at a waking time [ns]; return the fault of what is missing beside it, or None."""
        for missing in AWAITED:
            if missing == kind:
                self._since_ns.pop(missing, None)
            elif (silent_ns := now_ns - self._since_ns.setdefault(missing, now_ns)) > self._most_ns:
                return f"{missing}_stopped", f"no {missing} for {silent_ns * 1e-9:.2f} s"
        return None
