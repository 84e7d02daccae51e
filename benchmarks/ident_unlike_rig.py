"""Twenty systems unlike the rig: the automatic call beside SIPPY's N4SID and SciPy's output error of every order.

    peers/bin/pip install numpy scipy tqdm sippy_unipi
    PYTHONPATH=. peers/bin/python -m benchmarks.ident_unlike_rig [--systems N] [--most-poles N]

FIT [%] of the worst output on the half that was not seen, where offset, ramp and initial state are fitted to every
model alike.  The peers get every even order and their best one is shown, chosen by the unseen half itself, and linear
interpolation over gaps, which they cannot take; ours gets one call, and the data as they are.  What is lost of the
outputs is lost of the input as well, elsewhere; the unseen half has an input without gaps.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import time
import warnings

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from beam_ident import EstimationError, Prior, TimeRecord, identify
from benchmarks.ident.unlike_rig import N_SYSTEMS, UnlikeRig, unlike_rig, unseen_fits


def sampled(record: TimeRecord) -> tuple[np.ndarray, np.ndarray]:
    """Return input (n,) and outputs (n, n_outputs) at the stamps, gaps bridged by straight lines."""
    times = record.outputs[0].times_s
    u = np.interp(times, record.inputs[0].times_s, record.inputs[0].values)
    seen = [(o.values, np.isfinite(o.values)) for o in record.outputs]
    return u, np.stack([np.interp(times, times[ok], y[ok]) for y, ok in seen], axis=1)


def fits(system: UnlikeRig, matrices: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the FIT [%] of a discrete state space on the unseen half, with offset, ramp and start fitted to it."""
    a, b, c, d = matrices
    u, _ = sampled(system.second)
    n, m = len(u), len(c)
    state, simulated = np.zeros(len(a)), np.empty((n, m))
    free = np.empty((n, m, len(a)))
    power = np.eye(len(a))
    for k in range(n):
        simulated[k] = c @ state + d[:, 0] * u[k]
        state = a @ state + b[:, 0] * u[k]
        free[k] = c @ power
        power = a @ power
    line = np.linspace(-1.0, 1.0, n)
    seen = [np.isfinite(o.values) for o in system.second.outputs]
    own = np.zeros((n, m, 2 * m))
    for j in range(m):
        own[:, j, 2 * j], own[:, j, 2 * j + 1] = 1.0, line
    columns = np.concatenate([free, own], axis=2)
    left = [o.values - simulated[:, j] for j, o in enumerate(system.second.outputs)]
    rows = np.concatenate([columns[ok, j] for j, ok in enumerate(seen)])
    found = np.linalg.lstsq(
        rows, np.concatenate([e[ok] for e, ok in zip(left, seen, strict=True)]), rcond=None
    )[0]
    result = []
    for j, (output, ok) in enumerate(zip(system.second.outputs, seen, strict=True)):
        error = left[j][ok] - columns[ok, j] @ found
        values = output.values[ok]
        result.append(100.0 * (1.0 - np.linalg.norm(error) / np.linalg.norm(values - np.mean(values))))
    return np.array(result)


def n4sid(system: UnlikeRig, order: int) -> tuple[np.ndarray, ...]:
    """Return matrices by SIPPY's N4SID, after a straight line was taken off every output."""
    from sippy_unipi import system_identification

    u, y = sampled(system.first)
    line = np.stack([np.ones(len(u)), np.linspace(-1.0, 1.0, len(u))], axis=1)
    y = y - line @ np.linalg.lstsq(line, y, rcond=None)[0]
    found = system_identification(
        y.T,
        u[None],
        "N4SID",
        tsample=system.period,
        SS_fixed_order=order,
        SS_f=max(30, order),
        SS_p=max(30, order),
    )
    return found.A, found.B, found.C, found.D


def output_error(system: UnlikeRig, start: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Refine a state space by scipy.optimize.least_squares in modal coordinates: poles, numerators by projection."""
    a, b, c, _ = start
    u, y = sampled(system.first)
    line = np.stack([np.ones(len(u)), np.linspace(-1.0, 1.0, len(u))], axis=1)
    values = np.linalg.eigvals(a)
    values = values / np.maximum(1.0, np.abs(values) / 0.9999)
    upper, real = values[values.imag > 1e-12], np.sort(values[np.abs(values.imag) <= 1e-12].real)

    def columns(theta: np.ndarray) -> np.ndarray:
        pairs = theta[: 2 * len(upper)].reshape(-1, 2)
        made = [u]
        for radius, angle in pairs:
            denominator = [1.0, -2.0 * radius * np.cos(angle), radius**2]
            made += [lfilter([0.0, 1.0], denominator, u), lfilter([0.0, 0.0, 1.0], denominator, u)]
        made += [lfilter([0.0, 1.0], [1.0, -pole], u) for pole in theta[2 * len(upper) :]]
        return np.concatenate([np.stack(made, axis=1), line], axis=1)

    def misfit(theta: np.ndarray) -> np.ndarray:
        x = columns(theta)
        scale = np.linalg.norm(x, axis=0) + 1e-300
        basis = np.linalg.qr(x / scale)[0]
        return ((y - basis @ (basis.T @ y)) / np.std(y, axis=0)).ravel()

    theta = np.concatenate([np.stack([np.abs(upper), np.angle(upper)], axis=1).ravel(), real])
    bounds = (
        np.r_[np.tile([0.0, 0.0], len(upper)), -np.ones(len(real))],
        np.r_[np.tile([0.99999, np.pi], len(upper)), np.full(len(real), 0.99999)],
    )
    theta = np.clip(theta, bounds[0] + 1e-9, bounds[1] - 1e-9)
    found = least_squares(misfit, theta, bounds=bounds, x_scale="jac", max_nfev=15).x
    coefficients = np.linalg.lstsq(columns(found), y, rcond=None)[0]
    n = 2 * len(upper) + len(real)
    a, b, c = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((y.shape[1], n))
    for k, (radius, angle) in enumerate(found[: 2 * len(upper)].reshape(-1, 2)):
        a[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[2.0 * radius * np.cos(angle), -(radius**2)], [1.0, 0.0]]
        b[2 * k, 0] = 1.0
        c[:, 2 * k : 2 * k + 2] = coefficients[1 + 2 * k : 3 + 2 * k].T
    for k, pole in enumerate(found[2 * len(upper) :], 2 * len(upper)):
        a[k, k], b[k, 0], c[:, k] = pole, 1.0, coefficients[1 + k]
    return a, b, c, coefficients[0][:, None]


def peers(system: UnlikeRig, most_poles: int) -> dict[str, tuple[float, int]]:
    """Return the best FIT of the worst output over all even orders, and that order, of both peers."""
    best = {"N4SID": (-np.inf, 0), "output error": (-np.inf, 0)}
    for order in range(2, most_poles + 1, 2):
        try:
            with (
                warnings.catch_warnings(),
                contextlib.redirect_stdout(io.StringIO()),
                np.errstate(all="ignore"),
            ):
                warnings.simplefilter("ignore")
                start = n4sid(system, order)
                best["N4SID"] = max(best["N4SID"], (float(np.min(fits(system, start))), order))
                refined = output_error(system, start)
                best["output error"] = max(
                    best["output error"], (float(np.min(fits(system, refined))), order)
                )
        except Exception:  # noqa: BLE001  a peer may fail in any way of its own
            continue
    return best


def main() -> None:
    """Print the table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ident_unlike_rig", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--systems", type=int, default=N_SYSTEMS)
    parser.add_argument("--most-poles", type=int, default=30)
    arguments = parser.parse_args()
    print(
        "| system | beam_ident, one call | modes | N4SID, best order | output error, best order | truth | time [s] |"
    )
    print("|---|---|---|---|---|---|---|")
    for seed in range(arguments.systems):
        system = unlike_rig(seed)
        start = time.process_time()
        try:
            model = identify(system.first, system.structure, latency=Prior(0.0, np.inf)).model
            ours, modes = f"{np.min(unseen_fits(system, model)):.2f}", str(model.n_modes)
        except EstimationError:
            ours, modes = "refused", "-"
        seconds = time.process_time() - start
        found = peers(system, arguments.most_poles) if arguments.most_poles else {}
        others = " | ".join(f"{fit:.2f} ({order})" for fit, order in found.values())
        of_truth = np.min(unseen_fits(system, system.truth))
        print(
            f"| {system.title} | {ours} | {modes} | {others} | {of_truth:.2f} | {seconds:.1f} |", flush=True
        )


if __name__ == "__main__":
    main()
