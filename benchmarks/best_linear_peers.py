"""The package best-linear-approximation beside this library, on the data of `benchmarks.ident.best_linear`.

    python3.12 -m venv peers && peers/bin/pip install numpy scipy tqdm best-linear-approximation
    PYTHONPATH=. peers/bin/python -m benchmarks.best_linear_peers [--studies N]

Both get the same periods.  Compared are the errors of the response in its own standard deviations, and the variances
of noise and distortion over the true ones.  The package states no bands: for the noise it gets those that follow from
the numbers of realisations and periods, and none for the distortion, a difference that is cut at zero.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import best_linear_approximation as package
import numpy as np

from beam_ident.best_linear.variance_bands import variance_band
from benchmarks.ident.best_linear import (
    BandStudy,
    CubicLoop,
    Friction,
    FrictionLoop,
    M,
    NoisyInput,
    P,
    Polynomial,
    Signals,
)

CASES: dict[str, tuple[type[BandStudy], str]] = {
    "polynomial, known input": (Polynomial, "known_input"),
    "polynomial, measured input": (NoisyInput, "noisy_input"),
    "friction, known input": (Friction, "known_input"),
    "friction in a loop": (FrictionLoop, "closed_loop"),
    "stiffening spring in a loop": (CubicLoop, "closed_loop"),
}


def of_package(case: BandStudy, signals: Signals, name: str) -> tuple[np.ndarray, ...]:
    """Return response, its total variance, and one realisation's variances by noise and by distortion."""
    u, y = (np.transpose(own, (2, 0, 1))[:, None] for own in (signals.drive, signals.output))
    r = np.transpose(signals.reference)[:, None]
    given = {"known_input": (r, y), "noisy_input": (u, y), "closed_loop": (r, u, y)}[name]
    estimate: Callable[..., Any] = getattr(package.robust, name)
    found = estimate(*given, case.n_samples / case.period_s, case.excited, show_warnings=False).G
    parts = [found.value, found.total.var, M * found.noise.var, M * found.nonlinear.var]
    return tuple(part[:, 0, 0] for part in parts)


def of_library(case: BandStudy, signals: Signals) -> tuple[np.ndarray, ...]:
    """Return the same of this library."""
    found = case.approximation(signals)
    total = found.total_covariance[:, 0, 0].real
    return found.response[:, 0], total, found.excited.noise[:, 0], found.excited.distortion[:, 0]


def main() -> None:
    """Print one line for each case and estimator."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.best_linear_peers", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--studies", type=int, default=200, help="of each case (default 200)")
    studies = parser.parse_args().studies
    print("| case | by | squared z of the response | noise over truth | held | distortion over truth |")
    for title, (make, name) in CASES.items():
        case = make()
        truth = case.truth
        rows: dict[str, list[list[float]]] = {"this library": [], "the package": []}
        for seed in range(studies):
            signals = case.simulate(np.random.default_rng(seed), M)
            for who, (response, total, noise, distortion) in (
                ("this library", of_library(case, signals)),
                ("the package", of_package(case, signals, name)),
            ):
                low, high = variance_band(noise, np.full(len(noise), 2.0 * M * (P - 1)))
                known = truth.noise["excited"]
                rows[who].append(
                    [
                        float(np.mean(np.abs(response - truth.response) ** 2 / total)),
                        float(np.mean(noise / known)),
                        float(np.mean((low <= known) & (known <= high))),
                        float(np.mean(distortion / truth.distortion["excited"])),
                    ]
                )
        for who, found in rows.items():
            print(f"| {title} | {who} | " + " | ".join(f"{own:.3f}" for own in np.mean(found, axis=0)) + " |")


if __name__ == "__main__":
    main()
