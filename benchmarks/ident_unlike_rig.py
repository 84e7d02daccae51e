"""Twenty systems unlike the rig: the automatic call beside SIPPY's N4SID and SciPy's output error of every order.

    peers/bin/pip install numpy scipy tqdm sippy_unipi
    PYTHONPATH=. peers/bin/python -m benchmarks.ident_unlike_rig [--systems N] [--most-poles N] [--into FILE]

FIT [%] of the worst output on the half that was not seen, where offset, ramp and initial state are fitted to every
model alike.  The peers get every even order and their best one is shown, chosen by the unseen half itself, and linear
interpolation over gaps, which they cannot take; ours gets one call, and the data as they are.  What is lost of the
outputs is lost of the input as well, elsewhere; the unseen half has an input without gaps.

Every fit has a limit of processor time.  Results go to FILE, a line each, as soon as they are known: a run that was
stopped goes on from there.  Delete the file when the code has changed.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from beam_ident import EstimationError, Prior, TimeRecord, identify
from benchmarks.ident.unlike_rig import N_SYSTEMS, UnlikeRig, unlike_rig, unseen_fits

OURS, TRUTH, N4SID, OUTPUT_ERROR = "beam_ident", "truth", "N4SID", "output error"
LIMIT_S = 120.0  # of processor time for the one call
PEER_LIMIT_S = 20.0  # for each order of each peer
HORIZON = 30  # samples, of N4SID; not less than the order
EVALUATIONS = 50  # of output error and its gradient

Matrices = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Entry:
    """One fit to one system.

    Attributes
    ----------
    system : int
    by : str -- who
    order : int -- number of poles that were asked for; 0 where nobody asked
    fit : float -- FIT [%] of the worst output on the unseen half; minus infinity where there is no model
    modes : int -- that a model has
    seconds : float -- of processor time
    stopped : bool -- whether it came to the limit of time
    """

    system: int
    by: str
    order: int = 0
    fit: float = -np.inf
    modes: int = 0
    seconds: float = 0.0
    stopped: bool = False


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in what takes longer than so much processor time."""

    def end(number: int, frame: FrameType | None) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def sampled(record: TimeRecord) -> tuple[np.ndarray, np.ndarray]:
    """Return input (n,) and outputs (n, n_outputs) at the stamps, gaps bridged by straight lines."""
    times = record.outputs[0].times_s
    u = np.interp(times, record.inputs[0].times_s, record.inputs[0].values)
    seen = [(o.values, np.isfinite(o.values)) for o in record.outputs]
    return u, np.stack([np.interp(times, times[ok], y[ok]) for y, ok in seen], axis=1)


def fits(system: UnlikeRig, matrices: Matrices) -> np.ndarray:
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


def detrended(system: UnlikeRig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return input, outputs and a straight line's columns of the first half."""
    u, y = sampled(system.first)
    return u, y, np.stack([np.ones(len(u)), np.linspace(-1.0, 1.0, len(u))], axis=1)


def n4sid(system: UnlikeRig, order: int) -> Matrices:
    """Return matrices by SIPPY's N4SID, after a straight line was taken off every output."""
    from sippy_unipi import system_identification

    u, y, line = detrended(system)
    y = y - line @ np.linalg.lstsq(line, y, rcond=None)[0]
    horizon = max(HORIZON, order)
    found = system_identification(
        y.T, u[None], "N4SID", tsample=system.period, SS_fixed_order=order, SS_f=horizon, SS_p=horizon
    )
    return found.A, found.B, found.C, found.D


class PoleProblem:
    """Output error as a function of discrete poles, what enters linearly projected out, with its gradient.

    Parameters
    ----------
    system : UnlikeRig
    n_pairs : int -- of complex poles, each a radius and an angle; real poles follow
    """

    def __init__(self, system: UnlikeRig, n_pairs: int) -> None:
        self.u, self.y, self.line = detrended(system)
        self.n_pairs, self.levels = n_pairs, np.std(self.y, axis=0)

    def split(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return radius and angle of every pair, and the real poles."""
        return theta[: 2 * self.n_pairs].reshape(-1, 2), theta[2 * self.n_pairs :]

    def columns(self, theta: np.ndarray) -> np.ndarray:
        """Return what enters linearly: the input, what every pole makes of it, and a line."""
        pairs, real = self.split(theta)
        made = [self.u]
        for radius, angle in pairs:
            late = lfilter([0.0, 1.0], [1.0, -2.0 * radius * np.cos(angle), radius**2], self.u)
            made += [late, _later(late)]
        made += [lfilter([0.0, 1.0], [1.0, -pole], self.u) for pole in real]
        return np.concatenate([np.stack(made, axis=1), self.line], axis=1)

    def solved(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return columns, an orthonormal basis of them, and coefficients, shape (n_columns, n_outputs)."""
        columns = self.columns(theta)
        sizes = np.linalg.norm(columns, axis=0) + 1e-300
        basis, upper = np.linalg.qr(columns / sizes)
        coefficients = np.linalg.lstsq(upper, basis.T @ self.y, rcond=None)[0]
        return columns, basis, coefficients / sizes[:, None]

    def misfit(self, theta: np.ndarray) -> np.ndarray:
        """Return what is left of all outputs, each in units of its own size."""
        basis = self.solved(theta)[1]
        return np.asarray(((self.y - basis @ (basis.T @ self.y)) / self.levels).ravel())

    def gradient(self, theta: np.ndarray) -> np.ndarray:
        """Return the gradient of that with the columns' own change alone (Kaufman 1975): its slope is exact."""
        columns, basis, found = self.solved(theta)
        pairs, real = self.split(theta)
        slopes = []
        for k, (radius, angle) in enumerate(pairs):
            denominator = [1.0, -2.0 * radius * np.cos(angle), radius**2]
            once = lfilter([0.0, 1.0], denominator, columns[:, 1 + 2 * k])
            twice = _later(once)
            by_first, by_second = (
                -np.outer(own, found[1 + 2 * k]) - np.outer(_later(own), found[2 + 2 * k])
                for own in (once, twice)
            )
            slopes.append(-2.0 * np.cos(angle) * by_first + 2.0 * radius * by_second)
            slopes.append(2.0 * radius * np.sin(angle) * by_first)
        for k, pole in enumerate(real, 1 + 2 * self.n_pairs):
            slopes.append(np.outer(lfilter([0.0, 1.0], [1.0, -pole], columns[:, k]), found[k]))
        left = [-(slope - basis @ (basis.T @ slope)) / self.levels for slope in slopes]
        return np.stack([own.ravel() for own in left], axis=1)


def _later(column: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], column[:-1]])


def output_error(system: UnlikeRig, start: Matrices) -> Matrices:
    """Refine the poles of a state space by scipy.optimize.least_squares, numerators by projection."""
    values = np.linalg.eigvals(start[0])
    values = values / np.maximum(1.0, np.abs(values) / 0.9999)
    upper, real = values[values.imag > 1e-12], np.sort(values[np.abs(values.imag) <= 1e-12].real)
    theta = np.concatenate([np.stack([np.abs(upper), np.angle(upper)], axis=1).ravel(), real])
    bounds = (
        np.r_[np.tile([0.0, 0.0], len(upper)), -np.ones(len(real))],
        np.r_[np.tile([0.99999, np.pi], len(upper)), np.full(len(real), 0.99999)],
    )
    theta = np.clip(theta, bounds[0] + 1e-9, bounds[1] - 1e-9)
    problem = PoleProblem(system, len(upper))
    found = least_squares(
        problem.misfit, theta, problem.gradient, bounds=bounds, x_scale="jac", max_nfev=EVALUATIONS
    ).x
    coefficients = problem.solved(found)[2]
    n = len(theta)
    a, b, c = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((len(problem.levels), n))
    pairs, real = problem.split(found)
    for k, (radius, angle) in enumerate(pairs):
        a[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[2.0 * radius * np.cos(angle), -(radius**2)], [1.0, 0.0]]
        b[2 * k, 0] = 1.0
        c[:, 2 * k : 2 * k + 2] = coefficients[1 + 2 * k : 3 + 2 * k].T
    for k, pole in enumerate(real, 2 * len(upper)):
        a[k, k], b[k, 0], c[:, k] = pole, 1.0, coefficients[1 + k]
    return a, b, c, coefficients[0][:, None]


def ours(number: int, system: UnlikeRig) -> Entry:
    """Return the entry of the automatic call; at the limit of time it returns the model so far."""
    start = time.process_time()

    def on_time(phrase: str, share: float) -> None:
        if time.process_time() - start > LIMIT_S:
            raise TimeoutError

    try:
        model = identify(system.first, system.structure, latency=Prior(0.0, np.inf), progress=on_time).model
        fit, modes = float(np.min(unseen_fits(system, model))), model.n_modes
    except (EstimationError, TimeoutError):
        fit, modes = -np.inf, 0
    seconds = time.process_time() - start
    return Entry(number, OURS, 0, fit, modes, seconds, stopped=seconds > LIMIT_S)


def peer(
    number: int, system: UnlikeRig, by: str, order: int, estimate: Callable[[], Matrices]
) -> tuple[Entry, Matrices | None]:
    """Return the entry of one order of a peer, and its model."""
    start, stopped, fit = time.process_time(), False, -np.inf
    found: Matrices | None = None
    try:
        with (
            warnings.catch_warnings(),
            contextlib.redirect_stdout(io.StringIO()),
            np.errstate(all="ignore"),
        ):
            warnings.simplefilter("ignore")
            with limited(PEER_LIMIT_S):
                found = estimate()
            fit = float(np.nan_to_num(np.min(fits(system, found)), nan=-np.inf))
    except TimeoutError:
        stopped = True
    except Exception:  # noqa: BLE001  a peer may fail in any way of its own
        pass
    return Entry(number, by, order, fit, 0, time.process_time() - start, stopped), found


def entries(number: int, most_poles: int, known: set[tuple[str, int]]) -> Iterator[Entry]:
    """Yield what is not known yet of one system."""
    system = unlike_rig(number)
    if (TRUTH, 0) not in known:
        fit = float(np.min(unseen_fits(system, system.truth)))
        yield Entry(number, TRUTH, 0, fit, system.truth.n_modes)
    if (OURS, 0) not in known:
        yield ours(number, system)
    for order in range(2, most_poles + 1, 2):
        if (OUTPUT_ERROR, order) in known:
            continue
        entry, start = peer(number, system, N4SID, order, lambda order=order: n4sid(system, order))
        if (N4SID, order) not in known:
            yield entry
        if start is None:
            yield Entry(number, OUTPUT_ERROR, order)
        else:
            yield peer(number, system, OUTPUT_ERROR, order, lambda start=start: output_error(system, start))[
                0
            ]


def row(number: int, own: list[Entry]) -> str:
    """Return a system's line of the table."""
    (truth,), (found,) = ([e for e in own if e.by == name] for name in (TRUTH, OURS))
    cells = [unlike_rig(number).title, _percent(found), f"{found.modes} of {truth.modes}"]
    for name in (N4SID, OUTPUT_ERROR):
        best = max((e for e in own if e.by == name), key=lambda e: e.fit, default=None)
        cells.append("-" if best is None else f"{_percent(best)} ({best.order})")
    peers = sum(e.seconds for e in own if e.order)
    cells += [f"{truth.fit:.2f}", f"{found.seconds:.1f}", f"{peers:.0f}"]
    return "| " + " | ".join(cells) + " |"


def _percent(entry: Entry) -> str:
    return (f"{entry.fit:.2f}" if np.isfinite(entry.fit) else "none") + " (stopped)" * entry.stopped


def summary(found: list[Entry]) -> str:
    """Return what the table says in a sentence."""
    by_system: dict[int, list[Entry]] = {}
    for entry in found:
        by_system.setdefault(entry.system, []).append(entry)
    behind, ahead, right = [], [], 0
    for own in by_system.values():
        (truth,), (mine,) = ([e for e in own if e.by == name] for name in (TRUTH, OURS))
        behind.append(truth.fit - mine.fit)
        right += mine.modes == truth.modes
        if fits_of_peers := [e.fit for e in own if e.order]:
            ahead.append(mine.fit - max(fits_of_peers))
    stopped = sum(e.stopped for e in found if e.order)
    said = (
        f"{len(by_system)} systems: FIT behind the truth's {np.median(behind):.2f} in the median, "
        f"{max(behind):.2f} at worst; all modes and no other in {right}"
    )
    if ahead:
        said += f"; ahead of the best order of all peers by {min(ahead):.2f} at least"
    return f"{said}; {stopped} fits of peers stopped after {PEER_LIMIT_S:.0f} s."


def main() -> None:
    """Print the table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ident_unlike_rig", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--systems", type=int, default=N_SYSTEMS)
    parser.add_argument("--most-poles", type=int, default=30)
    parser.add_argument(
        "--into", type=Path, help="file of results, a line each, which a further run goes on from"
    )
    arguments = parser.parse_args()
    found: list[Entry] = []
    if arguments.into is not None and arguments.into.exists():
        found = [
            Entry(**json.loads(line)) for line in arguments.into.read_text(encoding="utf-8").splitlines()
        ]
        found = [e for e in found if e.system < arguments.systems]
    print(
        "| system | beam_ident, one call | modes | N4SID, best order | output error, best order | truth "
        "| time [s] | all peers' [s] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for number in range(arguments.systems):
        known = {(e.by, e.order) for e in found if e.system == number}
        for entry in entries(number, arguments.most_poles, known):
            found.append(entry)
            if arguments.into is not None:
                with arguments.into.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(entry)) + "\n")
        print(row(number, [e for e in found if e.system == number]), flush=True)
    print("\n" + summary(found))


if __name__ == "__main__":
    main()
