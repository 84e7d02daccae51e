"""An axis of a laboratory's own: it stands where the last set-point says, and measures itself every 20 ms."""

import numpy as np

from beam_ros.hub.contract import HubCapabilities, HubReport, HubStatus, Outcome, SampleBatch
from beam_ros.hub.gate.command_gate import CommandGate

PERIOD_NS, TICKS = 1_000_000, 20


class ToyAxis:
    capabilities = HubCapabilities("toy", ("position",), rate=50.0, shortcomings=("it is a toy",))

    def __init__(self, rig, guard):
        self._gate = CommandGate(rig.axis_parameters(), guard)
        self._offset = rig.axis_options().get("offset", 0.0)
        self._state, self._position, self._n_requests, self._completed = "identified", 0.0, 0, []
        self._tick = None

    def request(self, kind):
        self._n_requests += 1
        self._completed.append((self._n_requests, Outcome(True, f"the toy did {kind}")))
        self._state = "enabled" if kind == "enable" else "homed"
        return self._n_requests

    def setpoint(self, stamp_ns, value, now):
        outcome = self._gate.check_setpoint(stamp_ns, value, now.unix_ns, self._state, self._position, 0.0)
        self._position = value if outcome.success else self._position
        return outcome

    def load(self, chunk, now):
        self._gate.add(chunk, now.unix_ns, self._state, self._position, 0.0)
        self._gate.finish("refused", "the toy plays no sequences")

    def poll(self, now):
        newest = now.unix_ns // PERIOD_NS
        first, self._tick = self._tick or newest, newest // TICKS * TICKS
        positions = np.full(max(0, self._tick - first), self._position + self._offset)
        batch = SampleBatch(first * PERIOD_NS, PERIOD_NS, 1, positions=positions)
        completed, self._completed = self._completed, []
        status = HubStatus(self._state, self._position)
        return HubReport(
            [], [batch] if len(batch) else [], self._gate.take_reports(), [], completed, status, []
        )

    def close(self): ...
