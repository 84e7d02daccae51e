"""Peers side by side: the same records, the same truth, errors in units of the Cramer-Rao bound.

    python -m venv peers && peers/bin/pip install numpy scipy tqdm sippy_unipi scikit-rf sdypy-EMA
    PYTHONPATH=. peers/bin/python -m benchmarks.ident_peers [--runs N] [--slow-runs N] [--systems NAME ...]

Two systems: Rao-Garnier at 10 dB (2000 samples), and the tip of the three-mode beam at 20 dB
(10 000 samples).  Compared are the natural frequencies and damping ratios, which every peer can
give.  A run fails without the right number of stable complex pairs, or with any figure more than ten
bounds away.  Peers are helped where they need it: orders are given to all, vector fitting and the EMA get
the band that the input excites and, for the picking of poles, the true frequencies.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, csd, lfilter, welch

from beam_ident import TimeRecord, estimate_transfer_function
from beam_ident.responses.local_polynomial import local_polynomial_response
from beam_ident.subspace.model import subspace_model
from benchmarks.ident.forced_beam import ForcedBeam
from tests.beam_ident import rao_garnier

Poles = np.ndarray


@dataclass(frozen=True)
class System:
    """Records with a known truth: degrees, natural frequencies and damping ratios, band of the input [Hz]."""

    title: str
    record: Callable[[int], TimeRecord]
    degrees: tuple[int, int]
    truth: np.ndarray
    bound: np.ndarray
    period: float
    band: tuple[float, float]


@dataclass(frozen=True)
class Peer:
    """A way to the poles [rad/s] of a record, and whether it takes so long that it gets fewer runs."""

    title: str
    poles: Callable[[System, TimeRecord], Poles]
    is_slow: bool = False


def figures(poles: Poles) -> np.ndarray:
    """Return natural frequencies [rad/s] and damping ratios of the stable pairs, in order of frequency."""
    poles = np.asarray(poles, dtype=np.complex128)
    pairs = poles[(poles.imag > 0.0) & (poles.real < 0.0)]
    pairs = pairs[np.argsort(np.abs(pairs))]
    return np.concatenate([np.abs(pairs), -pairs.real / np.abs(pairs)])


def systems() -> dict[str, System]:
    """Return both systems; their bounds come from records with a thousandth of the noise."""
    true_poles = np.roots(np.concatenate([[1.0], rao_garnier.PARAMETERS[:4]]))
    quiet = estimate_transfer_function(rao_garnier.benchmark_record(0, 70.0), 4, 1).model.modes()
    garnier = System(
        "Rao-Garnier 10 dB",
        lambda seed: rao_garnier.benchmark_record(seed, 10.0),
        (4, 1),
        figures(true_poles),
        1e3 * np.concatenate(quiet[2:]),
        rao_garnier.PERIOD_S,
        (0.03, 8.0),
    )
    beam = ForcedBeam()
    quiet = estimate_transfer_function(beam.record(0, 20.0, quiet=1e-3).select(["tip"]), 6, 4).model.modes()
    tip = System(
        "beam, tip 20 dB",
        lambda seed: beam.record(seed, 20.0).select(["tip"]),
        (6, 4),
        beam.truth,
        1e3 * np.concatenate(quiet[2:]),
        beam.period,
        (0.8, 48.0),
    )
    return {"rao-garnier": garnier, "beam": tip}


def ours(system: System, record: TimeRecord) -> Poles:
    """Return the poles of estimate_transfer_function, with no start."""
    return estimate_transfer_function(record, *system.degrees).model.poles


def ours_subspace(system: System, record: TimeRecord) -> Poles:
    """Return the poles of PO-MOESP alone, where the other starts."""
    return subspace_model(record, system.degrees[0]).poles


def scipy_fit(system: System, record: TimeRecord, denominator: np.ndarray, numerator: np.ndarray) -> Poles:
    """Fit coefficients by scipy.optimize.least_squares with its numeric Jacobian, time in convenient units."""
    n = system.degrees[0]
    unit = float(np.exp(np.mean(np.log(np.abs(np.roots(denominator))))))
    powers = np.concatenate([unit ** np.arange(1, n + 1), unit ** np.arange(n - len(numerator) + 1, n + 1.0)])
    start = np.concatenate([denominator[1:], numerator]) / powers
    drive, values = record.inputs[0].values, record.outputs[0].values

    def misfit(theta: np.ndarray) -> np.ndarray:
        system_s = (theta[n:], np.concatenate([[1.0], theta[:n]]))
        above, below, _ = cont2discrete(system_s, system.period * unit, "zoh")
        return np.nan_to_num(values - lfilter(above[0], below, drive), nan=1e6, posinf=1e6, neginf=-1e6)

    found = least_squares(misfit, start, x_scale=np.maximum(np.abs(start), 1e-3), max_nfev=300)
    return np.roots(np.concatenate([[1.0], found.x[:n]])) * unit


def scipy_from_subspace(system: System, record: TimeRecord) -> Poles:
    """Start SciPy where our own chain starts."""
    start = subspace_model(record, system.degrees[0])
    return scipy_fit(system, record, start.denominator, start.numerators[0, 0, -(system.degrees[1] + 1) :])


def scipy_naive(system: System, record: TimeRecord) -> Poles:
    """Start SciPy at damped pairs in the middle of the band, with a gain of one."""
    middle = 2.0 * np.pi * np.sqrt(system.band[0] * system.band[1])
    denominator = np.array([1.0])
    for _ in range(system.degrees[0] // 2):
        denominator = np.convolve(denominator, [1.0, 1.4 * middle, middle**2])
    numerator = np.zeros(system.degrees[1] + 1)
    numerator[-1] = denominator[-1]
    return scipy_fit(system, record, denominator, numerator)


def response(system: System, record: TimeRecord, is_local: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return a frequency response inside the band: our local polynomials, or Welch's H1 over half records."""
    if is_local:
        local = local_polynomial_response(record)
        frequencies, values = local.frequencies_hz, np.squeeze(local.response)
    else:
        u, y = record.inputs[0].values, record.outputs[0].values
        frequencies, power = welch(u, 1.0 / system.period, nperseg=len(u) // 2)
        values = csd(u, y, 1.0 / system.period, nperseg=len(u) // 2)[1] / power
    keep = (frequencies >= system.band[0]) & (frequencies <= system.band[1])
    return frequencies[keep], values[keep]


def vector_fitting(system: System, record: TimeRecord, is_local: bool) -> Poles:
    """Fit pairs to the frequency response by scikit-rf."""
    import skrf
    from skrf.vectorFitting import VectorFitting

    frequencies, values = response(system, record, is_local)
    network = skrf.Network(f=frequencies, f_unit="Hz", s=values[:, None, None], z0=50)
    fit = VectorFitting(network)
    fit.vector_fit(n_poles_real=0, n_poles_cmplx=system.degrees[0] // 2, fit_constant=True, enforce_dc=False)
    return np.asarray(fit.poles)


def modal_analysis(system: System, record: TimeRecord, is_local: bool) -> Poles:
    """Pick the poles nearest to the true frequencies from sdypy-EMA's least-squares complex frequency method."""
    from sdypy import EMA

    frequencies, values = response(system, record, is_local)
    model = EMA.Model(
        values[None],
        frequencies,
        lower=frequencies[0],
        upper=frequencies[-1],
        pol_order_high=40,
        frf_form="receptance",
    )
    model.get_poles(show_progress=False)
    n = system.degrees[0] // 2
    model.select_closest_poles(list(system.truth[:n] / (2.0 * np.pi)), f_window=5)
    omega, zeta = 2.0 * np.pi * np.asarray(model.nat_freq), np.asarray(model.nat_xi)
    return -zeta * omega + 1j * omega * np.sqrt(np.maximum(1.0 - zeta**2, 0.0))


def sippy(system: System, record: TimeRecord, method: str, **options: Any) -> Poles:
    """Identify by SIPPY in discrete time, and take the logarithm of its poles."""
    from sippy_unipi import system_identification

    n = system.degrees[0]
    drive, values = record.inputs[0].values, record.outputs[0].values
    found = system_identification(values, drive, method, tsample=system.period, **options)
    discrete = (
        np.linalg.eigvals(found.A) if hasattr(found, "A") else np.roots(np.ravel(found.G.den[0][0])[: n + 1])
    )
    return np.log(np.asarray(discrete, dtype=np.complex128)) / system.period


PEERS = (
    Peer("beam_ident, no start", ours),
    Peer("beam_ident, PO-MOESP alone", ours_subspace),
    Peer("SciPy least_squares from PO-MOESP", scipy_from_subspace),
    Peer("SciPy least_squares, naive start", scipy_naive),
    Peer("sdypy-EMA on local polynomials", lambda s, r: modal_analysis(s, r, True)),
    Peer("sdypy-EMA on H1", lambda s, r: modal_analysis(s, r, False)),
    Peer("scikit-rf vector fitting on local polynomials", lambda s, r: vector_fitting(s, r, True)),
    Peer("scikit-rf vector fitting on H1", lambda s, r: vector_fitting(s, r, False)),
    Peer(
        "SIPPY N4SID, horizon 50",
        lambda s, r: sippy(s, r, "N4SID", SS_fixed_order=s.degrees[0], SS_f=50, SS_p=50),
    ),
    Peer(
        "SIPPY output error",
        lambda s, r: sippy(s, r, "OE", OE_orders=[s.degrees[0], s.degrees[0], 1]),
        is_slow=True,
    ),
)


def line(system: System, peer: Peer, runs: int) -> dict[str, Any]:
    """Return a peer's line of the table."""
    errors, seconds, failures = [], [], 0
    for seed in range(runs):
        record = system.record(seed)
        start = time.perf_counter()
        try:
            with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
                warnings.simplefilter("ignore")
                found = figures(peer.poles(system, record))
        except Exception:  # noqa: BLE001  a peer may fail in any way of its own; that is what is counted
            found = np.empty(0)
        seconds.append(time.perf_counter() - start)
        if len(found) != len(system.truth):
            failures += 1
            continue
        error = np.abs(found - system.truth) / system.bound
        failures += int(np.any(error > 10.0))
        errors.append(error)
    rms = np.sqrt(np.mean(np.square(errors), axis=0)) if errors else np.full(len(system.truth), np.nan)
    return {
        "system": system.title,
        "peer": peer.title,
        "runs": runs,
        "failures": failures,
        "error / bound, median": f"{np.median(errors):.3g}" if errors else "-",
        "rms, best and worst figure": f"{np.min(rms):.3g}, {np.max(rms):.3g}" if errors else "-",
        "median time [s]": f"{np.median(seconds):.3g}",
    }


def main() -> None:
    """Print the table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ident_peers", description="Peers side by side."
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--slow-runs", type=int, default=3, help="for peers that take more than 10 s a run")
    parser.add_argument("--systems", nargs="*", default=["rao-garnier", "beam"])
    arguments = parser.parse_args()
    known = systems()
    is_first = True
    for name in arguments.systems:
        for peer in PEERS:
            # SIPPY's output error takes 2 s on Rao-Garnier and 20 to 40 s on the beam.
            is_slow = peer.is_slow and name == "beam"
            row = line(known[name], peer, arguments.slow_runs if is_slow else arguments.runs)
            if is_first:
                print("| " + " | ".join(row) + " |\n" + "|---" * len(row) + "|")
                is_first = False
            print("| " + " | ".join(str(value) for value in row.values()) + " |", flush=True)


if __name__ == "__main__":
    main()
