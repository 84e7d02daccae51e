"""Does an identification through rendered frames scatter as it says?

The default rig is simulated into a bag: hub, plant and camera with exposure, rolling shutter and noise. Every frame
is rendered and tracked, the bag is read and identified without hints. The plant is linear, so that what is
estimated exists; all markers rest exactly on a pixel centre, where a tracker that leans towards whole pixels would
show it. From run to run the noise of the images differs and, as the stated deviations count the rounding of the hub's
encoder as noise, so does that: the excitation is a little smaller each time.

And through the strip alone: sixty points of a beam on which nothing is glued, in frames of which only the strip's
own columns are rendered, and once: every run adds noise of its own to their light.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import InputSignal, OutputSignal, TimeRecord, identify
from beam_ident.modal_identification.time_domain import CLOCK_RATE_PRIOR
from beam_ros.bags.reading import Bag
from beam_ros.messages import BagTypes
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.offline.simulation import Measure, simulate
from beam_ros.offline.whole_beam import strip_parameters
from beam_ros.rig.filming import Exposure, Film
from beam_ros.rig.rig import Rig
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.strip.moving_line import StripFollower
from benchmarks.ident.study import Outcome, Study

N_MODES = 3
"""Modes within the excited band."""

_SHRINK = 3e-4
"""The excitation is smaller by this share from run to run: by 1.5 um of its 5 mm, fifteen steps of the encoder."""
_FINE_COUNT_M = 1e-10
"""Counts so fine that they are the motion of a filmed hub itself."""


class ScoresByKind:
    """The figures of a case by kind of parameter: ``truth`` and ``kinds``, both of shape (n_parameters,)."""

    truth: np.ndarray
    kinds: np.ndarray

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return, by kind of parameter, errors over stated standard deviations and the share within 1.96 of them."""
        good = [o for o in outcomes if o.estimate is not None]
        figures: dict[str, Any] = {"failures": len(outcomes) - len(good)}
        if not good:
            return figures
        scores = np.array([(o.estimate - self.truth) / o.sd for o in good])
        for name in dict.fromkeys(self.kinds.tolist()):
            own = scores[:, self.kinds == name]
            figures[f"{name}, rms z"] = round(float(np.sqrt(np.mean(own**2))), 3)
            figures[f"{name}, largest mean z"] = round(float(np.abs(own.mean(axis=0)).max()), 2)
            figures[f"{name}, covered"] = round(float(np.mean(np.abs(own) < 1.96)), 4)
        figures["covered"] = round(float(np.mean(np.abs(scores) < 1.96)), 4)
        for name in dict.fromkeys(name for o in good for name in o.figures):
            values = np.array([o.figures[name] for o in good])
            figures[f"rms {name}"] = round(float(np.sqrt(np.mean(values**2))), 3)
        figures["largest |z|"] = round(float(np.abs(scores).max()), 2)
        return figures


class FilmedBeam(ScoresByKind):
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
        self.kinds = np.repeat(np.array(["frequencies", "damping", "residues", "residual terms"]), sizes)

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


class FilmedStrip(ScoresByKind):
    """A strip of 1 px without dots, 150 grey levels above the ground, followed at sixty heights for 2.4 s.

    One film is made, of a hub whose motion is known. New in every run are the camera's noise, the encoder's zero, and
    by how much the camera's clock runs fast: as much as ``identify`` believes that clocks do.
    """

    N_MODES = 2

    def __init__(self) -> None:
        usual = Rig.from_file()
        self._count_m = usual.hub.encoder_resolution
        self.rig = usual.with_values(
            {
                "hub.encoder_resolution": _FINE_COUNT_M,
                "camera.width": 72,
                "camera.height": 612,
                "camera.pixels_per_metre": 2005.0,
                "camera.origin_u": 36.3,
                "camera.origin_v": 605.0,
                "excitation.duration": 1.6,
                "excitation.still": 0.4,
                "excitation.start_frequency": 3.0,
                "excitation.end_frequency": 40.0,
                "excitation.max_displacement": 0.002,
                "excitation.acceleration": 0.4,
                "beam.damping_ratios": [0.02],
            }
        )
        camera = self.rig.camera_parameters()
        self.camera = replace(
            camera, noise_grey=2.0, strip_contrast=150.0, strip_width_m=1.0 / camera.pixels_per_metre
        )
        self._parameters = strip_parameters(self.camera, self.rig.beam.length, 10)
        rows = self._follower().rows_px
        self.heights = (camera.origin_px[1] - rows) / camera.pixels_per_metre
        self._film()
        model = self.rig.beam_model()
        modes = slice(self.N_MODES)
        shapes = np.asarray(model.motion_residues(self.heights))[:, modes]
        self.truth = np.concatenate(
            [model.natural_frequencies[modes], model.damping_ratios[modes], shapes.ravel()]
        )
        sizes = (self.N_MODES, self.N_MODES, shapes.size)
        self.kinds = np.repeat(np.array(["frequencies", "damping", "shapes"]), sizes)

    def _follower(self) -> StripFollower:
        return StripFollower(self._parameters, (self.camera.height, self.camera.width))

    def _film(self) -> None:
        """Keep the light of every frame, when it was taken, and the hub's record."""
        lights: list[np.ndarray] = []
        stamps: list[int] = []

        def begin(rig: Rig, film: Film, _types: BagTypes) -> Measure:
            renderer = SceneRenderer(self.camera, rig.markers.heights, strip_heights=film.strip_heights)

            def measure(exposure: Exposure) -> Iterator[tuple[str, Any]]:
                lights.append(renderer.light(np.full_like(exposure.markers, np.nan), exposure.strip))
                stamps.append(exposure.stamp_ns)
                yield from ()

            return measure

        with tempfile.TemporaryDirectory() as folder:
            simulate(self.rig, Path(folder) / "bag", measure=begin, strip_points=151)
            with Bag(Path(folder) / "bag") as bag:
                hub = bag.hub_samples()
        assert hub.positions is not None
        times = (hub.stamps_ns - hub.stamps_ns[0]) * 1e-9
        at = (np.array(stamps) - int(hub.stamps_ns[0])) * 1e-9
        inside = (at > 0.05) & (at < times[-1] - 0.05)
        self._period_s, self._positions = float(np.median(np.diff(times))), hub.positions
        self._light, self._times = np.array(lights)[inside], at[inside]

    def record(self, seed: int) -> TimeRecord:
        """Follow the strip through the film with fresh noise."""
        rng, follower, found = np.random.default_rng(seed), self._follower(), []
        for light in self._light:
            noisy = light + self.camera.noise_grey * rng.standard_normal(light.shape, dtype=np.float32)
            found.append(follower.process(np.clip(np.rint(noisy), 0, 255).astype(np.uint8)).u_px)
        zero = self._count_m * rng.random()
        middle = float(np.mean(self._times))
        stamps = middle + (self._times - middle) * (1.0 + CLOCK_RATE_PRIOR.sd * rng.standard_normal())
        counted = self._count_m * np.round((self._positions - zero) / self._count_m) + zero
        hub = InputSignal("hub", "m", (0.0, self._period_s), counted, "cubic")
        x = (np.array(found) - self.camera.origin_px[0]) / self.camera.pixels_per_metre
        outputs = []
        for j, height in enumerate(self.heights):
            seen = np.isfinite(x[:, j])
            name = f"z{height * 1e3:05.1f}"
            outputs.append(OutputSignal(name, "m", stamps[seen], x[seen, j], self.camera.exposure_s))
        return TimeRecord((hub,), tuple(outputs))

    def run(self, seed: int) -> Outcome:
        """Follow and identify."""
        started = time.process_time()
        record = self.record(seed)
        model = identify(record, n_modes=self.N_MODES).model
        seconds = time.process_time() - started
        order = [model.output_names.index(output.name) for output in record.outputs]
        if model.n_modes != self.N_MODES:
            return Outcome(seconds)
        return Outcome(
            seconds,
            np.concatenate([model.natural_frequencies, model.damping_ratios, model.residues[order].ravel()]),
            np.concatenate(
                [model.natural_frequency_sd, model.damping_ratio_sd, model.residue_sd[order].ravel()]
            ),
        )


STUDIES = {
    "filmed_beam": Study("identification through rendered frames, rolling shutter", 50, FilmedBeam),
    "filmed_beam_at_once": Study(
        "identification through rendered frames, global shutter",
        50,
        lambda: FilmedBeam({"camera.readout": 0.0}),
    ),
    "filmed_strip": Study("a strip without dots at sixty heights", 200, FilmedStrip),
}
