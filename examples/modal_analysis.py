"""Modal analysis: frequencies, damping ratios and shapes at the measured points, with their uncertainty."""

import numpy as np
from simulated_beam import TRUTH, film

from beam_ident import identify

# Two runs in one fit: poles, residues and their covariance are common to both.
model = identify([film(1), film(2)]).model

print("mode   f [Hz]              zeta [%]            decay time [s]")
for k in range(model.n_modes):
    omega, zeta = model.natural_frequencies[k], model.damping_ratios[k]
    f_sd, zeta_sd = model.natural_frequency_sd[k] / (2 * np.pi), model.damping_ratio_sd[k]
    print(f"{k + 1:>4}   {omega / (2 * np.pi):.5f} +- {f_sd:.5f}", end="")
    print(f"   {100 * zeta:.4f} +- {100 * zeta_sd:.4f}   {1 / (zeta * omega):.2f}")

# A column of residues is the mode's shape at the points, times how strongly the base drives it.
print("shapes, largest point = 1")
for k in range(model.n_modes):
    residues, sd = model.residues[:, k], model.residue_sd[:, k]
    largest = np.abs(residues).max()
    points = zip(model.output_names, residues / largest, sd / largest, strict=True)
    print(f"{k + 1:>4}   " + ", ".join(f"{name} {value:+.4f} +- {s:.4f}" for name, value, s in points))


def modal_assurance(a: np.ndarray, b: np.ndarray) -> float:
    """Return the squared correlation of two shapes (MAC)."""
    return float((a @ b) ** 2 / ((a @ a) * (b @ b)))


for k in range(model.n_modes):
    row = [modal_assurance(model.residues[:, k], TRUTH.residues[:, j]) for j in range(TRUTH.n_modes)]
    print(f"MAC of mode {k + 1} with the true shapes: " + ", ".join(f"{value:.4f}" for value in row))
