"""Whether a trajectory controller's settings let it follow the knots: asked until they are known.

Joint states often come before the controller does: a broadcaster is mostly started first. So a controller whose
settings cannot be asked for is driven for now, and still asked as soon as they can be.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from beam_ros.hub.links.trajectory import CONTROLLER_SETTINGS, TrajectoryHub, settings_objection

PATIENCE_S = 2.0
"""So long answers are waited for before a question is repeated, and a controller is waited for [s]."""


class SettingsCheck:
    """Asks for every setting until it is answered; a verdict holds as long as the same controller is there.

    One question for each: a node answers nothing at all to a list that has a name which it does not know. A late
    answer counts as well as one in time, so that no load is too high for a verdict.

    Parameters
    ----------
    hub : TrajectoryHub -- takes the verdict; its motor stays off until the first one
    ask : callable -- asks for one of ``CONTROLLER_SETTINGS``; ``answer`` takes what comes back
    warn : callable -- is called when the motor is released without the settings
    joint, mode : str -- the controller's joint, and the hub's command mode
    """

    def __init__(
        self,
        hub: TrajectoryHub,
        ask: Callable[[str], None],
        warn: Callable[[], None],
        joint: str,
        mode: str,
    ) -> None:
        self._hub, self._ask, self._warn, self._joint = hub, ask, warn, joint
        self._has_velocities = mode == "acceleration"
        self._since_s = 0.0
        self._asked_s = -math.inf
        self._known: dict[str, object] = {}
        self._verdict: str | None = None
        hub.awaits_check = True

    def look(self, now_s: float, *, is_there: bool) -> None:
        """Do what is due at steady time ``now_s`` [s]; ``is_there``: whether the controller takes questions."""
        hub = self._hub
        is_over = now_s - self._since_s > PATIENCE_S
        if not (hub.is_connected or self._verdict):
            # A controller that comes back may be another one.
            self._forget()
            self._since_s = now_s
            hub.awaits_check = True
        elif is_there:
            if self._verdict != "" and now_s - self._asked_s > PATIENCE_S:
                self._asked_s = now_s
                for name in CONTROLLER_SETTINGS:
                    if name not in self._known:
                        self._ask(name)
            if hub.awaits_check and is_over:
                hub.leave_off(
                    f"the controller has not said its settings: expected answers of get_parameters within "
                    f"{PATIENCE_S:g} s; look at its log and at the load of its computer, and try again"
                )
        else:
            if self._verdict == "":
                self._forget()
            if hub.awaits_check and is_over:
                hub.judge("")
                self._warn()

    def answer(self, name: str, value: object) -> None:
        """Take a setting; None where the controller has none of this name."""
        if self._verdict == "":
            return
        self._known[name] = value
        if len(self._known) == len(CONTROLLER_SETTINGS):
            settings = {name: value for name, value in self._known.items() if value is not None}
            self._known = {}
            self._verdict = settings_objection(settings, self._joint, has_velocities=self._has_velocities)
            self._hub.judge(self._verdict)

    def _forget(self) -> None:
        self._verdict = None
        self._known = {}
        self._asked_s = -math.inf
