"""Modal analysis: stabilisation chart, modes with standard deviations, shapes; from measured responses."""

import numpy as np

from beam_ident import (
    FrequencyRecord,
    analyse_modes,
    modal_assurance,
    phase_collinearity,
    stabilisation_chart,
)

# Three storeys of 1 kg on columns of 40 kN/m, hit at the top; accelerances with 1 % of noise.
stiffness = 4e4 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
squares, true_shapes = np.linalg.eigh(stiffness)
hertz = np.arange(5.0, 70.0, 0.05)
s = 2j * np.pi * hertz[:, None]
receptance = sum(
    true_shapes[:, k] * true_shapes[2, k] / (s**2 + 2 * 0.01 * np.sqrt(squares[k]) * s + squares[k])
    for k in range(3)
)
accelerance = s**2 * receptance
rng = np.random.default_rng(1)
noise = rng.standard_normal(accelerance.shape) + 1j * rng.standard_normal(accelerance.shape)
noise *= 0.01 * np.abs(accelerance) / np.sqrt(2)
record = FrequencyRecord(
    2 * np.pi * hertz, accelerance + noise, np.abs(0.01 * accelerance) ** 2, output_names=("1", "2", "3")
)

# Poles that come back order after order are modes; the others were made up by the order.
chart = stabilisation_chart(record, form="accelerance", max_order=12)
modes = analyse_modes(chart)
print(f"{len(chart.poles)} poles on the chart, {len(modes.natural_frequencies)} modes")
for k, omega in enumerate(modes.natural_frequencies):
    f, f_sd = omega / 2 / np.pi, modes.natural_frequency_sd[k] / 2 / np.pi
    zeta, zeta_sd = 100 * modes.damping_ratios[k], 100 * modes.damping_ratio_sd[k]
    off = (omega - np.sqrt(squares[k])) / modes.natural_frequency_sd[k]
    print(f"{f:.4f} +- {f_sd:.4f} Hz ({off:+.1f} sd), {zeta:.3f} +- {zeta_sd:.3f} %, ", end="")
    print("shape " + " ".join(f"{value.real:+.3f}" for value in modes.shapes[:, k]))
print("MAC with the true shapes:", np.round(np.diag(modal_assurance(modes.shapes, true_shapes)), 4))
print("phase collinearity:", np.round(phase_collinearity(modes.shapes), 4))
