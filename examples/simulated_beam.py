"""A beam with two modes, filmed at two points: the record that the examples work on."""

import numpy as np

from beam_ident import InputSignal, LogChirp, ModalModel, OutputSignal, Recipe, TimeRecord

TRUTH = ModalModel(
    structure="base_motion",
    input_name="hub",
    output_names=("root", "tip"),
    natural_frequencies=2 * np.pi * np.array([4.4, 28.3]),
    damping_ratios=np.array([0.008, 0.005]),
    residues=np.array([[0.01, -0.05], [1.5, -0.75]]),
    residual_terms=np.zeros(2),
    gains=np.ones(2),
    latency=0.0,
    clock_rate=0.0,
    covariance=np.zeros((14, 14)),
    noise_sd=np.ones(2),
)
CHIRP = LogChirp(start_frequency=1.0, end_frequency=45.0, duration=8.0, still=4.0)


def film(seed: int, recipe: Recipe = CHIRP, rate_hz: float = 100.0, noise: float = 4e-6) -> TimeRecord:
    """Return the hub's position at 1 kHz and what a camera of 5 ms exposure sees, with noise [m]."""
    excitation = recipe.sample(1e-3)
    position = excitation.input_signal("position", "hub")
    stamps = np.arange(1, int(excitation.duration_s * rate_hz) - 1) / rate_hz
    seen = TRUTH.simulate(position, stamps, exposure_s=5e-3)
    seen += noise * np.random.default_rng(seed).standard_normal(seen.shape)
    hub = InputSignal("hub", "m", position.times_s, position.values, "cubic")
    outputs = [OutputSignal(name, "m", stamps, seen[:, j], 5e-3) for j, name in enumerate(TRUTH.output_names)]
    return TimeRecord((hub,), tuple(outputs), name=f"run {seed}")
