"""How much faster than real time the simulated rig runs, with and without images, ideal and realistic.

    python -m benchmarks.simulated_rig [--seconds S] [--json FILE]

The plant runs the default excitation behind a `SimulatedHub` that is polled every 10 ms, as the node does it, and the
camera films it. Times are processor times of this one process: a factor of 4 is a quarter of a core. The node adds
messages and DDS to that (`benchmarks.vision_node` measures them); where the sum is beyond a core, it falls behind and
says so in its diagnostics.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from beam_ros import messages
from beam_ros.excitation.plan import plan_excitation
from beam_ros.hub.contract import HostTime
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.simulated_hub import SimulatedHub
from beam_ros.rig.filming import Film
from beam_ros.rig.rig import Rig
from beam_ros.vision.rendering.frames import SceneRenderer

POLL_NS = 10_000_000
START_NS = 1_700_000_000_000_000_000
REALISTIC = {"simulation.preset": "realistic"}
KINDS: dict[str, dict[str, Any]] = {
    "ideal": {},
    "realistic": REALISTIC,
    "realistic without air": {
        **REALISTIC,
        "simulation.drag_coefficient": 0.0,
        "simulation.large_deflections": False,
    },
    "ideal, effort": {"hub.command_mode": "effort", "excitation.acceleration": 0.2},
    "realistic, effort": {**REALISTIC, "hub.command_mode": "effort", "excitation.acceleration": 0.2},
}


class Run:
    """A simulated hub in made-up time, and the camera that films it."""

    def __init__(self, rig: Rig) -> None:
        model = rig.beam_model()
        drift_ppm = rig.simulation.hub_clock_ppm
        axis = VirtualAxis(
            rig.axis_parameters(), rig.simulated_plant(model, drift_ppm), rig.simulated_device(drift_ppm)
        )
        self.hub = SimulatedHub(axis)
        self._elapsed_ns = 0
        self.poll()
        self.film = Film(rig, model, self.hub.snapshots, self.hub.reached_ns)
        self._renderer = SceneRenderer(
            self.film.camera,
            rig.markers.heights,
            strip_heights=self.film.strip_heights,
            full_well=rig.simulation.full_well,
        )
        self._rng = np.random.default_rng(1)

    def poll(self) -> None:
        """Let a poll's time pass."""
        self._elapsed_ns += POLL_NS
        self.now = HostTime(self._elapsed_ns, START_NS + self._elapsed_ns)
        self.report = self.hub.poll(self.now)

    def excite(self, rig: Rig) -> None:
        """Bring the hub to where the rig's excitation starts."""
        for kind in ("home", "enable"):
            number = self.hub.request(kind)
            while number not in dict(self.report.completed):
                self.poll()
        start_ns = self.now.unix_ns + 1_000_000_000
        period_ns = rig.axis_parameters().period_ns
        for chunk in messages.split_sequence("speed", start_ns, period_ns, plan_excitation(rig).values):
            self.hub.load(chunk, self.now)
        while self.now.unix_ns < start_ns:
            self.poll()
            self.look()

    def look(self, *, with_images: bool = False) -> None:
        """Film what has happened since the last look."""
        for exposure in self.film.due(self.hub.reached_ns):
            if with_images:
                self._renderer.render(exposure.markers, self._rng, exposure.strip)
            else:
                self.film.mean_displacement(exposure)


def factor(rig: Rig, seconds: float, *, with_images: bool) -> float:
    """Return simulated seconds in a second of processor time."""
    run = Run(rig)
    run.excite(rig)
    begun = time.process_time()
    for _ in range(round(seconds * 1e9 / POLL_NS)):
        run.poll()
        run.look(with_images=with_images)
    if run.hub.axis.activity != "sequence":
        raise SystemExit(f"the sequence ended early: {run.hub.axis.activity} {run.hub.axis.reason}")
    return seconds / (time.process_time() - begun)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=5.0, help="of simulated time for each figure")
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    arguments = parser.parse_args()
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, {platform.machine()}")
    print("simulated seconds in a second of processor time\n")
    print(f"{'':24s}{'without images':>16s}{'with images':>14s}")
    figures: dict[str, float] = {}
    for kind, changes in KINDS.items():
        rig = Rig.from_file().with_values({"excitation.duration": arguments.seconds + 2.0, **changes})
        for with_images in (False, True):
            name = f"{kind}{', images' if with_images else ''}"
            figures[name] = factor(rig, arguments.seconds, with_images=with_images)
        print(f"{kind:24s}{figures[kind]:16.2f}{figures[f'{kind}, images']:14.2f}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
