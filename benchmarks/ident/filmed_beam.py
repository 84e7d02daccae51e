"""Does an identification through rendered frames scatter as it says?

The default rig is simulated into a bag: hub, plant and camera with exposure, rolling shutter and noise. Every frame
is rendered and tracked, the bag is read and identified without hints. The plant is linear, so that what is
estimated exists; all markers rest exactly on a pixel centre, where a tracker that leans towards whole pixels would
show it. From run to run the noise of the images differs and, as the stated deviations count the rounding of the hub's
encoder as noise, so does that: the excitation is a little smaller each time.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import identify
from beam_ros.offline.identification import load_experiment
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig
from benchmarks.ident.study import Outcome, Study

N_MODES = 3
"""Modes within the excited band."""

_SHRINK = 3e-4
"""The excitation is smaller by this share from run to run: by 1.5 um of its 5 mm, fifteen steps of the encoder."""


class FilmedBeam:
    """The default rig with a rolling shutter; ``changes`` are further parameters of the rig."""

    def __init__(self, changes: dict[str, object] | None = None) -> None:
        self.rig = Rig.from_file().with_values(
            {
                "camera.readout": 0.004,
                "excitation.duration": 20.0,
                "excitation.still": 5.0,
                **(changes or {}),
            }
        )
        model = self.rig.beam_model()
        heights = list(self.rig.markers.heights)
        omegas = model.natural_frequencies
        residues = np.asarray(model.motion_residues(heights))
        # Modes above the band act by their static deflection.
        residual = np.asarray(model.residual_terms(heights)) + (
            residues[:, N_MODES:] / omegas[N_MODES:] ** 2
        ).sum(axis=1)
        self.truth = np.concatenate(
            [omegas[:N_MODES], model.damping_ratios[:N_MODES], residues[:, :N_MODES].ravel(), residual]
        )
        sizes = (N_MODES, N_MODES, residues[:, :N_MODES].size, residual.size)
        self.classes = np.repeat(np.array(["frequencies", "damping", "residues", "residual terms"]), sizes)

    def run(self, seed: int) -> Outcome:
        """Simulate, film, track and identify."""
        started = time.process_time()
        amplitude = self.rig.excitation.acceleration * (1.0 - _SHRINK * seed)
        rig = self.rig.with_values({"simulation.seed": seed, "excitation.acceleration": amplitude})
        with tempfile.TemporaryDirectory() as folder:
            simulate(rig, Path(folder) / "bag", with_camera=True)
            experiment = load_experiment(Path(folder) / "bag")
        model = identify(
            experiment.record,
            experiment.structure,  # type: ignore[arg-type]
            clock_rate=experiment.clock_rate,
        ).model
        seconds = time.process_time() - started
        if model.n_modes != N_MODES:
            return Outcome(seconds)
        # With a rolling shutter the markers come in the order of their times.
        order = [model.output_names.index(name) for name in rig.markers.names]
        return Outcome(
            seconds,
            np.concatenate(
                [
                    model.natural_frequencies,
                    model.damping_ratios,
                    model.residues[order].ravel(),
                    model.residual_terms[order],
                ]
            ),
            np.concatenate(
                [
                    model.natural_frequency_sd,
                    model.damping_ratio_sd,
                    model.residue_sd[order].ravel(),
                    model.residual_term_sd[order],
                ]
            ),
            {"latency z": float(model.latency / model.latency_sd)},
        )

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return, by kind of parameter, the RMS of the errors over their stated standard deviations."""
        good = [o for o in outcomes if o.estimate is not None]
        figures: dict[str, Any] = {"failures": len(outcomes) - len(good)}
        if not good:
            return figures
        scores = np.array([(o.estimate - self.truth) / o.sd for o in good])
        for name in dict.fromkeys(self.classes.tolist()):
            own = scores[:, self.classes == name]
            figures[f"{name}, rms z"] = round(float(np.sqrt(np.mean(own**2))), 3)
            figures[f"{name}, largest mean z"] = round(float(np.abs(own.mean(axis=0)).max()), 2)
        latency = np.array([o.figures["latency z"] for o in good])
        figures["latency, rms z"] = round(float(np.sqrt(np.mean(latency**2))), 3)
        figures["largest |z|"] = round(float(np.abs(scores).max()), 2)
        return figures


STUDIES = {
    "filmed_beam": Study("identification through rendered frames, rolling shutter", 50, FilmedBeam),
    "filmed_beam_at_once": Study(
        "identification through rendered frames, global shutter",
        50,
        lambda: FilmedBeam({"camera.readout": 0.0}),
    ),
}
