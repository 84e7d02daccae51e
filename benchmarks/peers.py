"""The suite and its peers on the same records in one run: who wins where, and what could not be run.

    python -m venv peers && peers/bin/pip install numpy scipy
    PYTHONPATH=. peers/bin/python -m benchmarks.peers [--runs N] [--slow-runs N] [--records NAME ...]

NumPy and SciPy are all that it needs. A peer is run where it is installed, and so are the recordings (which need
rosbags and PyYAML) and the camera (OpenCV as well); what is missing is named at the end, with what installs it.  No
peer is a dependency of the project.

Compared are natural frequencies and damping ratios, which every peer can give.  Of all stable pairs those next
to the true frequencies are taken, which no peer could do by itself.  A run fails where a mode has no pair within a
tenth of its frequency, or any figure is more than ten Cramer-Rao bounds away.  Orders are given to all, and vector
fitting and modal analysis get the band that the input excites.  Times are of the processor, with one thread where
``OMP_NUM_THREADS=1`` is set.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import json
import logging
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, csd, lfilter, welch

from beam_ident import TimeRecord, estimate_transfer_function, fit_free_decay, identify
from beam_ident.responses.local_polynomial import local_polynomial_response
from beam_ident.subspace.model import subspace_model
from benchmarks.ident.forced_beam import ForcedBeam
from benchmarks.ident.free_decays import ManyPoints
from tests.beam_ident import rao_garnier

Poles = np.ndarray
ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Samples:
    """What everybody gets: the input at the outputs' times, and every output, shape (n_samples, n_outputs).

    ``record`` is the same with its stamps, as the suite takes it.
    """

    drive: np.ndarray
    values: np.ndarray
    record: TimeRecord

    @staticmethod
    def of_record(record: TimeRecord) -> Samples:
        """Return a record whose input and outputs have the same stamps."""
        return Samples(
            record.inputs[0].values, np.stack([own.values for own in record.outputs], axis=1), record
        )


@dataclass(frozen=True)
class System:
    """Records with a known truth: natural frequencies [rad/s], damping ratios, and their standard deviations at best.

    Attributes
    ----------
    kind : str -- force (one output, zero-order hold), motion (a hub that is led) or decay (nothing acts)
    samples : callable -- of a seed
    suite : callable -- poles of the samples [rad/s], as the suite finds them
    degrees : (int, int) -- number of poles, and of zeros where there is one output
    period : float -- [s]
    band : (float, float) -- what is excited [Hz]
    n_records : int -- how many there are at most
    """

    title: str
    kind: str
    samples: Callable[[int], Samples]
    suite: Callable[[Samples], Poles]
    degrees: tuple[int, int]
    truth: np.ndarray
    bound: np.ndarray
    period: float
    band: tuple[float, float]
    n_records: int = 1000

    def figures(self, poles: Poles) -> np.ndarray | None:
        """Return frequencies [rad/s] and damping ratios of the pairs next to the true modes; None where one lacks."""
        poles = np.asarray(poles, dtype=np.complex128)
        pairs = poles[(poles.imag > 0.0) & (poles.real < 0.0)]
        true = self.truth[: len(self.truth) // 2]
        if len(pairs) < len(true):
            return None
        apart = np.abs(np.abs(pairs) / true[:, None] - 1.0)
        nearest = np.argmin(apart, axis=1)
        if len(set(nearest)) < len(true) or np.any(np.min(apart, axis=1) > 0.1):
            return None
        pairs = pairs[nearest]
        return np.concatenate([np.abs(pairs), -pairs.real / np.abs(pairs)])


def pairs_of(omegas: np.ndarray, zetas: np.ndarray) -> Poles:
    """Return the upper poles [rad/s] of modes."""
    omegas, zetas = np.asarray(omegas), np.asarray(zetas)
    return -zetas * omegas + 1j * omegas * np.sqrt(np.maximum(1.0 - zetas**2, 0.0))


def transfer_function_of(degrees: tuple[int, int]) -> Callable[[Samples], Poles]:
    """Return the suite's estimate of a transfer function of these degrees, with no start."""
    return lambda own: estimate_transfer_function(own.record, *degrees).model.poles


def rao_garnier_system() -> System:
    """Return the Rao-Garnier benchmark; the bound comes from a record with a thousandth of the noise."""
    poles = np.roots(np.concatenate([[1.0], rao_garnier.PARAMETERS[:4]]))
    pairs = np.sort_complex(poles[poles.imag > 0.0])[::-1]
    quiet = estimate_transfer_function(rao_garnier.benchmark_record(0, 70.0), 4, 1).model.modes()
    return System(
        "Rao-Garnier 10 dB",
        "force",
        lambda seed: Samples.of_record(rao_garnier.benchmark_record(seed, 10.0)),
        transfer_function_of((4, 1)),
        (4, 1),
        np.concatenate([np.abs(pairs), -pairs.real / np.abs(pairs)]),
        1e3 * np.concatenate(quiet[2:]),
        rao_garnier.PERIOD_S,
        (0.03, 8.0),
    )


def beam_system() -> System:
    """Return the tip of the three-mode beam; the bound comes from a record with a thousandth of the noise."""
    beam = ForcedBeam()
    quiet = estimate_transfer_function(beam.record(0, 20.0, quiet=1e-3).select(["tip"]), 6, 4).model.modes()
    return System(
        "beam, tip 20 dB",
        "force",
        lambda seed: Samples.of_record(beam.record(seed, 20.0).select(["tip"])),
        transfer_function_of((6, 4)),
        (6, 4),
        beam.truth,
        1e3 * np.concatenate(quiet[2:]),
        beam.period,
        (0.8, 48.0),
    )


def decay_of(own: Samples) -> Poles:
    """Return what the suite's fit of free decays finds, with no hint."""
    found = fit_free_decay(own.record.outputs)
    return pairs_of(found.natural_frequencies, found.damping_ratios)


def decays_system() -> System:
    """Return the free decays of fifteen points with drift and a mode at one of them alone."""
    case = ManyPoints()
    rest = rao_garnier.benchmark_record(0, 10.0).inputs

    def samples(seed: int) -> Samples:
        return Samples.of_record(TimeRecord(rest, tuple(case.signals(seed))))

    return System(
        "decays of 15 points",
        "decay",
        samples,
        decay_of,
        (20, 0),
        case.truth,
        case.bound,
        1.0 / case.rate_hz,
        (1.0, 40.0),
    )


def bag_system(name: str) -> System:
    """Return a recording of `bags`; its bound is what the suite states, and of `decay` only the rest is taken.

    Raises ImportError where rosbags or PyYAML is missing.
    """
    from beam_ros.offline.loading.experiment import load_experiment

    told = json.loads((ROOT / "bags" / "expected.json").read_text(encoding="utf-8"))[name]
    modes, experiment = told["identified"]["modes"], load_experiment(ROOT / "bags" / name)
    record = experiment.record
    hub, is_decay = record.inputs[0], name == "decay"
    stamps = record.outputs[0].times_s
    if is_decay:
        moving = np.flatnonzero(np.abs(np.diff(hub.values)) > 0.0)[-1]
        record = record.between(float(hub.times_s[moving + 1]), float(stamps[-1]) + 1.0)
        stamps = record.outputs[0].times_s
    own = Samples(
        np.interp(stamps, hub.times_s, hub.values),
        np.stack([signal.values for signal in record.outputs], axis=1),
        record,
    )
    truth, sizes = told["truth"], ("frequency_sd_hz", "damping_ratio_sd")
    omegas, ratios = (np.array(truth[key])[: len(modes)] for key in ("natural_frequencies", "damping_ratios"))
    bounds = [np.array([mode[key] for mode in modes]) for key in sizes]
    if is_decay:
        found = fit_free_decay(record.outputs)
        bounds = [found.natural_frequency_sd / (2.0 * np.pi), found.damping_ratio_sd]

    def moved(own: Samples) -> Poles:
        model = identify(own.record, experiment.structure).model
        return pairs_of(model.natural_frequencies, model.damping_ratios)

    return System(
        f"bag `{name}`",
        "decay" if is_decay else "motion",
        lambda seed: own,
        decay_of if is_decay else moved,
        (2 * len(modes) + 2, 0),
        np.concatenate([omegas, ratios]),
        np.concatenate([2.0 * np.pi * bounds[0], bounds[1]]),
        float(np.median(np.diff(stamps))),
        (2.0, 45.0),
        1,
    )


SYSTEMS: dict[str, Callable[[], System]] = {
    "rao-garnier": rao_garnier_system,
    "beam": beam_system,
    "decays": decays_system,
    **{
        f"bag-{name}": lambda name=name: bag_system(name)
        for name in ("chirp_6s", "multisine", "step", "decay")
    },
}


# -- the peers ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Peer:
    """A way to the poles [rad/s] of samples: the package that it imports, what installs it, and the kinds it takes.

    ``is_slow`` is one that takes so long that it gets fewer runs.
    """

    title: str
    package: str
    install: str
    kinds: tuple[str, ...]
    poles: Callable[[System, Samples], Poles]
    is_slow: bool = False


def continuous(a: np.ndarray, system: System) -> Poles:
    """Return the poles [rad/s] of a state matrix in discrete time."""
    return np.log(np.linalg.eigvals(np.asarray(a)).astype(np.complex128)) / system.period


def ours_subspace(system: System, own: Samples) -> Poles:
    """Return the poles of PO-MOESP alone, where the other starts."""
    return subspace_model(own.record, system.degrees[0]).poles


@dataclass(frozen=True)
class OutputError:
    """The output error of a transfer function by its coefficients, time in convenient units.

    ``start`` are the denominator's and the numerator's coefficients where a search begins.
    """

    system: System
    own: Samples
    unit: float
    start: np.ndarray

    @staticmethod
    def of_coefficients(
        system: System, own: Samples, denominator: np.ndarray, numerator: np.ndarray
    ) -> OutputError:
        """Start from coefficients in seconds, in falling powers; the denominator is monic."""
        n = system.degrees[0]
        unit = float(np.exp(np.mean(np.log(np.abs(np.roots(denominator))))))
        exponents = (np.arange(1, n + 1), np.arange(n - len(numerator) + 1, n + 1.0))
        start = np.concatenate([denominator[1:], numerator]) / unit ** np.concatenate(exponents)
        return OutputError(system, own, unit, start)

    @staticmethod
    def of_subspace(system: System, own: Samples) -> OutputError:
        """Start where the suite's chain starts."""
        start = subspace_model(own.record, system.degrees[0])
        numerator = start.numerators[0, 0, -(system.degrees[1] + 1) :]
        return OutputError.of_coefficients(system, own, start.denominator, numerator)

    @property
    def scale(self) -> np.ndarray:
        """The size of every coefficient."""
        return np.maximum(np.abs(self.start), 1e-3)

    def misfit(self, theta: np.ndarray) -> np.ndarray:
        """Return the residuals, shape (n_samples,), of the coefficients."""
        n = self.system.degrees[0]
        pair = (theta[n:], np.concatenate([[1.0], theta[:n]]))
        above, below, _ = cont2discrete(pair, self.system.period * self.unit, "zoh")
        error = self.own.values[:, 0] - lfilter(above[0], below, self.own.drive)
        return np.nan_to_num(error, nan=1e6, posinf=1e6, neginf=-1e6)

    def poles(self, theta: np.ndarray) -> Poles:
        """Return the poles [rad/s] of the coefficients."""
        return np.roots(np.concatenate([[1.0], theta[: self.system.degrees[0]]])) * self.unit


def scipy_fit(error: OutputError) -> Poles:
    """Search by scipy.optimize.least_squares with its numeric Jacobian."""
    found = least_squares(error.misfit, error.start, x_scale=error.scale, max_nfev=300)
    return error.poles(found.x)


def scipy_from_subspace(system: System, own: Samples) -> Poles:
    """Start SciPy where our own chain starts."""
    return scipy_fit(OutputError.of_subspace(system, own))


def mujoco_from_subspace(system: System, own: Samples) -> Poles:
    """Search by the optimiser of mujoco.sysid, Gauss-Newton with its numeric Jacobian, from the same start."""
    from mujoco import minimize

    error = OutputError.of_subspace(system, own)

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.stack(
            [error.misfit(column * error.scale) for column in np.reshape(x, (len(x), -1)).T], axis=1
        )

    found, _ = minimize.least_squares(error.start / error.scale, residuals, verbose=0)
    return error.poles(np.ravel(found) * error.scale)


def scipy_naive(system: System, own: Samples) -> Poles:
    """Start SciPy at damped pairs in the middle of the band, with a gain of one."""
    middle = 2.0 * np.pi * np.sqrt(system.band[0] * system.band[1])
    denominator = np.array([1.0])
    for _ in range(system.degrees[0] // 2):
        denominator = np.convolve(denominator, [1.0, 1.4 * middle, middle**2])
    numerator = np.zeros(system.degrees[1] + 1)
    numerator[-1] = denominator[-1]
    return scipy_fit(OutputError.of_coefficients(system, own, denominator, numerator))


def response(system: System, own: Samples, is_local: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return a frequency response inside the band: our local polynomials, or Welch's H1 over half records."""
    if is_local:
        local = local_polynomial_response(own.record)
        frequencies, values = local.frequencies_hz, np.squeeze(local.response)
    else:
        u, y = own.drive, own.values[:, 0]
        frequencies, power = welch(u, 1.0 / system.period, nperseg=len(u) // 2)
        values = csd(u, y, 1.0 / system.period, nperseg=len(u) // 2)[1] / power
    keep = (frequencies >= system.band[0]) & (frequencies <= system.band[1])
    return frequencies[keep], values[keep]


def vector_fitting(system: System, own: Samples, is_local: bool) -> Poles:
    """Fit pairs to the frequency response by scikit-rf."""
    import skrf
    from skrf.vectorFitting import VectorFitting

    frequencies, values = response(system, own, is_local)
    network = skrf.Network(f=frequencies, f_unit="Hz", s=values[:, None, None], z0=50)
    fit = VectorFitting(network)
    fit.vector_fit(n_poles_real=0, n_poles_cmplx=system.degrees[0] // 2, fit_constant=True, enforce_dc=False)
    return np.asarray(fit.poles)


def modal_analysis(system: System, own: Samples, is_local: bool) -> Poles:
    """Pick the poles nearest to the true frequencies from sdypy-EMA's least-squares complex frequency method."""
    from sdypy import EMA

    frequencies, values = response(system, own, is_local)
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


def sippy(system: System, own: Samples, method: str, **options: Any) -> Poles:
    """Identify by SIPPY in discrete time, and take the logarithm of its poles."""
    from sippy_unipi import system_identification

    n = system.degrees[0]
    values = own.values[:, 0] if own.values.shape[1] == 1 else own.values.T
    found = system_identification(values, own.drive, method, tsample=system.period, **options)
    if hasattr(found, "A"):
        return continuous(found.A, system)
    return continuous(np.diag(np.roots(np.ravel(found.G.den[0][0])[: n + 1])), system)


def era(system: System, own: Samples) -> Poles:
    """Realise python-control's Markov parameters of a forced record, or the decays as they are, by its ERA."""
    import control

    n = system.degrees[0]
    if system.kind == "decay":
        rows = min(200, len(own.values) // 3)
        responses = own.values.T[:, None, :]
    else:
        rows = min(200, len(own.values) // 12)
        found = control.markov(own.values.T, own.drive[None], 2 * rows + 1)
        responses = np.reshape(found, (own.values.shape[1], 1, -1))
    model, _ = control.eigensys_realization(responses, n, m=rows, n=rows, dt=system.period)
    return continuous(model.A, system)


def stochastic_subspace(system: System, own: Samples) -> Poles:
    """Return the poles of pyOMA2's covariance-driven subspace, which is told the input where there is one."""
    from pyoma2.algorithms import SSI
    from pyoma2.setup import SingleSetup

    logging.getLogger("pyoma2").setLevel(logging.ERROR)
    n, drive = system.degrees[0], own.drive[:, None]
    more = {"method": "cov"} if system.kind == "decay" else {"method": "IOcov", "U": drive}
    setup = SingleSetup(own.values - np.mean(own.values, axis=0), fs=1.0 / system.period)
    algorithm = SSI(name="ssi", br=40, ordmin=n, ordmax=n, **more)
    setup.add_algorithms(algorithm)
    setup.run_all()
    return continuous(algorithm.result.A[-1], system)


def jax_sysid(system: System, own: Samples) -> Poles:
    """Return the poles of jax-sysid's linear model from its own start: Adam, then L-BFGS, no regularisation."""
    import jax
    from jax_sysid.models import LinearModel
    from jax_sysid.utils import standard_scale

    jax.config.update("jax_enable_x64", True)
    values, _, _ = standard_scale(own.values)
    drive, _, _ = standard_scale(own.drive[:, None])
    model = LinearModel(system.degrees[0], values.shape[1], 1, feedthrough=True)
    model.loss(rho_x0=0.0, rho_th=0.0)
    model.optimization(adam_epochs=1000, lbfgs_epochs=2000, iprint=-1)
    model.fit(values, drive)
    return continuous(model.ssdata()[0], system)


PEERS = (
    Peer("the suite, no start", "scipy", "scipy", ("force", "motion", "decay"), lambda s, r: s.suite(r)),
    Peer("the suite's PO-MOESP alone", "scipy", "scipy", ("force",), ours_subspace),
    Peer("SciPy least_squares from PO-MOESP", "scipy", "scipy", ("force",), scipy_from_subspace),
    Peer("SciPy least_squares, naive start", "scipy", "scipy", ("force",), scipy_naive),
    Peer("mujoco.minimize from PO-MOESP", "mujoco", "mujoco", ("force",), mujoco_from_subspace),
    Peer(
        "SIPPY N4SID, horizon 50",
        "sippy_unipi",
        "sippy_unipi",
        ("force", "motion"),
        lambda s, r: sippy(s, r, "N4SID", SS_fixed_order=s.degrees[0], SS_f=50, SS_p=50),
    ),
    Peer(
        "SIPPY output error",
        "sippy_unipi",
        "sippy_unipi",
        ("force",),
        lambda s, r: sippy(s, r, "OE", OE_orders=[s.degrees[0], s.degrees[0], 1]),
        is_slow=True,
    ),
    Peer("jax-sysid linear model", "jax_sysid", "jax-sysid", ("force", "motion"), jax_sysid, is_slow=True),
    Peer("python-control, ERA", "control", "control", ("force", "motion", "decay"), era),
    Peer("pyOMA2 SSI", "pyoma2", "pyOMA-2", ("force", "motion", "decay"), stochastic_subspace),
    Peer(
        "sdypy-EMA on local polynomials",
        "sdypy",
        "sdypy-EMA",
        ("force",),
        lambda s, r: modal_analysis(s, r, True),
    ),
    Peer("sdypy-EMA on H1", "sdypy", "sdypy-EMA", ("force",), lambda s, r: modal_analysis(s, r, False)),
    Peer(
        "scikit-rf vector fitting on local polynomials",
        "skrf",
        "scikit-rf",
        ("force",),
        lambda s, r: vector_fitting(s, r, True),
    ),
    Peer(
        "scikit-rf vector fitting on H1",
        "skrf",
        "scikit-rf",
        ("force",),
        lambda s, r: vector_fitting(s, r, False),
    ),
)


# -- the tables -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """What came of one peer on the records of one system.

    ``errors`` are in units of the bound, of the runs that found every mode, shape (n_found, n_figures).
    """

    system: System
    peer: Peer
    runs: int
    failures: int
    errors: np.ndarray
    seconds: float

    @property
    def size(self) -> float:
        """The median error in units of the bound; infinite where no run found every mode."""
        return float(np.median(self.errors)) if self.errors.size else np.inf

    def line(self, suite_seconds: float) -> dict[str, str]:
        """Return the peer's line of the table; the suite's time on the same records is the unit of time."""
        half = self.errors.shape[-1] // 2
        relative = 100.0 * self.errors * self.system.bound / self.system.truth
        has = bool(self.errors.size)

        def shown(values: np.ndarray) -> str:
            return f"{np.median(values):.3g}" if has else "-"

        return {
            "record": self.system.title,
            "by": self.peer.title,
            "runs": str(self.runs),
            "failed": str(self.failures),
            "frequency, error / bound": shown(self.errors[:, :half]),
            "damping, error / bound": shown(self.errors[:, half:]),
            "frequency [%]": shown(relative[:, :half]),
            "damping [%]": shown(relative[:, half:]),
            "time / the suite's": f"{self.seconds / suite_seconds:.3g}",
        }


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep what peers print, and their bars, from between the rows."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def score(system: System, peer: Peer, runs: int) -> Score:
    """Run a peer on the records of a system."""
    errors, seconds, failures = [], [], 0
    for seed in range(runs):
        own = system.samples(seed)
        start = time.process_time()
        try:
            with warnings.catch_warnings(), quiet():
                warnings.simplefilter("ignore")
                found = system.figures(peer.poles(system, own))
        except Exception:  # noqa: BLE001  a peer may fail in any way of its own; that is what is counted
            found = None
        seconds.append(time.process_time() - start)
        if found is None:
            failures += 1
            continue
        error = np.abs(found - system.truth) / system.bound
        failures += int(np.any(error > 10.0))
        errors.append(error)
    return Score(
        system,
        peer,
        runs,
        failures,
        np.reshape(errors, (len(errors), len(system.truth))),
        float(np.median(seconds)),
    )


def winners(scores: Sequence[Score]) -> dict[str, str]:
    """Return who is best on one system, by failures, then by error; and who is quickest with as few failures."""
    best = min(scores, key=lambda own: (own.failures, own.size))
    least = [own for own in scores if own.failures == best.failures and np.isfinite(own.size)]
    level = [own for own in least if own.size <= 1.01 * best.size]
    quick = min(least, key=lambda own: own.seconds) if least else None
    return {
        "record": scores[0].system.title,
        "nearest to the truth": ", ".join(own.peer.title for own in level) or "nobody",
        "failed of runs": f"{best.failures} of {best.runs}",
        "quickest with as few failures": quick.peer.title if quick else "nobody",
    }


def printed(rows: Iterator[dict[str, str]]) -> None:
    """Print a table, a row as soon as it is known."""
    for number, row in enumerate(rows):
        if number == 0:
            print("| " + " | ".join(row) + " |\n" + "|---" * len(row) + "|")
        print("| " + " | ".join(row.values()) + " |", flush=True)


def camera_rows(frames: int) -> Iterator[dict[str, str]]:
    """Yield the trackers of one film after another; raise ImportError where OpenCV is missing."""
    vision = importlib.import_module("benchmarks.vision")
    with quiet():
        rows = vision.compare(frames, ["disc_model", "pyidi", "blob_detector", "trackpy"])
    unit = {row["scene"]: row["ms_per_frame"] for row in rows if row["method"] == "disc_model"}
    for row in rows:
        yield {
            "film": row["scene"],
            "by": "the suite, disc_model" if row["method"] == "disc_model" else row["method"],
            "RMS [px]": f"{row['rms_px']:.4f}",
            "RMS / bound": f"{row['bounds']:.3g}",
            "time / the suite's": f"{row['ms_per_frame'] / unit[row['scene']]:.3g}",
        }


def not_run() -> list[str]:
    """Return a line for every peer that is not run, with the reason."""
    wanted = {peer.package: peer.install for peer in PEERS} | {"pyidi": "pyidi", "trackpy": "trackpy"}
    lines = [
        f"{name}: not installed here; pip install {name}"
        for package, name in wanted.items()
        if find_spec(package) is None
    ]
    return [
        *lines,
        "CAPTAIN: neither PyPI nor Debian 12 has it; it comes from its authors, for MATLAB or Octave",
        "ControlSystemIdentification.jl: it needs Julia, which Debian 12 does not have",
    ]


def main(words: Sequence[str] | None = None) -> int:
    """Print every table, and what was not run."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--slow-runs", type=int, default=2, help="for peers that take more than 10 s a run")
    parser.add_argument("--records", nargs="*", choices=(*SYSTEMS, "camera"), default=(*SYSTEMS, "camera"))
    parser.add_argument("--frames", type=int, default=200, help="of each film of the camera")
    arguments = parser.parse_args(words)
    ready = [peer for peer in PEERS if find_spec(peer.package) is not None]
    summary, missing = [], not_run()

    def rows() -> Iterator[dict[str, str]]:
        for name in arguments.records:
            try:
                system = SYSTEMS[name]() if name in SYSTEMS else None
            except ImportError as err:
                missing.append(f"{name}: needs {err.name}, which is not installed here")
                continue
            scores: list[Score] = []
            for peer in ready if system else ():
                if system.kind in peer.kinds:
                    runs = arguments.slow_runs if peer.is_slow else arguments.runs
                    scores.append(score(system, peer, min(runs, system.n_records)))
                    yield scores[-1].line(scores[0].seconds)
            if scores:
                summary.append(winners([own for own in scores if own.runs == scores[0].runs]))

    printed(rows())
    if summary:
        print()
        printed(iter(summary))
    if "camera" in arguments.records:
        print()
        try:
            printed(camera_rows(arguments.frames))
        except ImportError as err:
            missing.append(f"camera: needs {err.name}, which is not installed here")
    print("\nNot run:\n\n" + "\n".join(f"- {line}" for line in missing))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
