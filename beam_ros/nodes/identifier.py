"""The node ``identifier``: a model from the bag of its parameter, published as JSON.

The fit takes seconds, so it runs in a thread of its own; the executor keeps answering meanwhile.
"""

from __future__ import annotations

import contextlib
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beam_ros import messages
from beam_ros.errors import faults_of_the_user
from beam_ros.interfaces.rig_parameters import IdentifierSettings
from beam_ros.process.remote_paths import AnyPath
from beam_ros.shell.node import RigNode, run_node

if TYPE_CHECKING:
    from beam_ros.offline.identification import Looked
    from beam_ros.offline.loading.options import FitOptions

_COLLECT_S = 0.1
_LOAD_AFTER_S = 5.0
"""The nodes of a rig start together; after that the estimators are loaded, before they are asked for [s]."""


class Identifier(RigNode):
    """Identifies one bag at a time."""

    def __init__(self, **options: Any) -> None:
        super().__init__("identifier", **options)
        self._result = self.offer("identification/result")
        self._thread: threading.Thread | None = None
        self._outcome: dict[str, Any] | None = None
        self._phrase = "ready"
        self.serve("identifier/identify", self._on_identify)
        self.create_timer(_COLLECT_S, self._collect)
        self._first_idle = self.create_timer(_LOAD_AFTER_S, self._load)

    def _load(self) -> None:
        """Load the estimators in the background, once, which takes seconds that nobody then waits for."""
        self._first_idle.cancel()
        estimator = self.rig.identifier.estimator
        threading.Thread(target=_load_identification, args=(estimator,), name="load", daemon=True).start()

    def _on_identify(self, _request: Any, response: Any) -> Any:
        settings = self.rig.identifier
        if self._thread is not None:
            response.success, response.message = False, f"busy: {self._phrase}"
        elif not settings.bag:
            response.success = False
            response.message = "no bag: set the parameter identifier.bag to a recorded bag's folder"
        else:
            self._thread = threading.Thread(target=self._identify, args=(settings,), daemon=True)
            self._thread.start()
            response.success, response.message = True, f"identifying {settings.bag}"
        return response

    def _identify(self, settings: IdentifierSettings) -> None:
        if not settings.report:
            first = Path(settings.bag.partition(";")[0].strip())
            settings = replace(settings, report=str(first.with_name(f"{first.name}_identified")))
        try:
            # The estimators take more than a second to load: the node is there, and complains, before.
            from beam_ros.checks.bag_check import BagCheck, check_bag
            from beam_ros.reporting.identification import identify_told

            checks: list[BagCheck] = []

            def check(path: AnyPath, options: FitOptions) -> Looked:
                checks.append(check_bag(path, None, options))
                return checks[-1].looked

            outcome = identify_told(settings, progress=self._on_progress, checked=check)
            self._outcome = {**outcome, "checks": [own.to_dict() for own in checks]}
        except faults_of_the_user() as err:
            self._outcome = {"bag": settings.bag, "error": str(err)}
        except Exception as err:
            self._outcome = {"bag": settings.bag, "error": f"{type(err).__name__}: {err}"}
            raise

    def _on_progress(self, phrase: str, share: float) -> None:
        self._phrase = f"{phrase} ({share:.0%})"

    def _collect(self) -> None:
        if self._outcome is None:
            return
        outcome, self._outcome, self._thread, self._phrase = self._outcome, None, None, "ready"
        if "error" in outcome:
            self.get_logger().error(outcome["error"])
        self._result.publish(messages.json_text(self.types, outcome))

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report what the fit is doing."""
        return "OK", self._phrase, {}


def _load_identification(estimator: str) -> None:
    from beam_ident import find_estimator
    from beam_ros.checks import bag_check  # noqa: F401
    from beam_ros.reporting import identification  # noqa: F401

    # Whoever asks for a fit by a name that nobody has is told then.
    with contextlib.suppress(*faults_of_the_user()):
        find_estimator(estimator)


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Identifier, argv)
