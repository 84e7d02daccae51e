"""The best linear approximation: an actuator that saturates before a beam; noise and distortion told apart."""

import numpy as np

from beam_ident import (
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    best_linear_approximation,
    fit_frequency_transfer_function,
)

# A mode at 4 Hz with 5 % of damping. The command goes through a soft saturation before it moves the beam.
omega, zeta = 2.0 * np.pi * 4.0, 0.05
denominator = np.array([1.0, 2 * zeta * omega, omega**2])
beam = TransferFunctionModel(np.array([omega**2]), denominator, 0.0, np.zeros((4, 4)), 0.0)
tick, period = 0.01, 10.0
lines = np.delete(
    np.arange(5, 150, 2), np.arange(2, 73, 4)
)  # one odd line of every four stays free for odd distortion

records = []
for seed in range(7):  # realisations: the same lines and amplitudes, other phases
    rng = np.random.default_rng(seed)
    spectrum = np.zeros(501, dtype=complex)
    spectrum[lines] = 1000 / np.sqrt(2 * len(lines)) * np.exp(2j * np.pi * rng.uniform(size=len(lines)))
    command = np.tile(np.fft.irfft(spectrum, 1000), 5)
    saturated = InputSignal("actuator", "m", (0.0, tick), np.tanh(0.5 * command) / 0.5, "band_limited")
    stamps = tick * np.arange(2, len(command) - 2)
    seen = beam.simulate(saturated, stamps) + 0.01 * rng.standard_normal(len(stamps))
    drive = InputSignal("command", "m", (0.0, tick), command, "band_limited")
    records.append(TimeRecord((drive,), (OutputSignal("tip", "m", stamps, seen),)))

best = best_linear_approximation(records, period, lines / period)
print(best.verdict)
print("distortion, 95 %:", np.sqrt(best.excited.distortion_band()[:, 20, 0]), "of", abs(best.response[20]))

# Intervals with the total covariance hold for other phases, too; with the noise alone they are too narrow.
for variance in ("total", "noise"):
    found = fit_frequency_transfer_function(best.record(variance), 2, 0).model
    (f,), (z,), (f_sd,), (z_sd,) = found.modes()
    print(
        f"{variance}: {f / 2 / np.pi:.5f} +- {f_sd / 2 / np.pi:.5f} Hz, {100 * z:.3f} +- {100 * z_sd:.3f} %"
    )
