"""Two records in one fit, a quiet and a loud one with offsets of their own: Rao-Garnier cut in two, and a beam."""

from __future__ import annotations

import dataclasses
import time
from functools import cached_property

import numpy as np

from beam_ident import (
    InputSignal,
    LogChirp,
    ModalModel,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    estimate_transfer_function,
    identify,
)
from benchmarks.ident.noise_models import coloured
from benchmarks.ident.study import AgainstBound, Outcome, Study
from tests.beam_ident import rao_garnier

PERIOD_S = rao_garnier.PERIOD_S
_CUT = 1000  # of 2000 samples
_OFFSETS = (40.0, -250.0)
_START_S = 37.2  # of the second record, on a clock of its own
_STEP = 1e-5  # of a parameter, for central differences


class TwoRecords(AgainstBound):
    """The six coefficients from two records of ten seconds, the second in motion when it begins.

    The first is seen at a regular clock, the second at stamps of any spacing, with three times the noise.

    Parameters
    ----------
    snr_db : float -- of the first record; the second has 9.5 dB less
    has_common_poles : bool -- estimate by `estimate_common_poles`
    """

    def __init__(self, snr_db: float = 10.0, has_common_poles: bool = False) -> None:
        self.has_common_poles = has_common_poles
        self.drive = rao_garnier.prbs(2000)
        rng = np.random.default_rng(3)
        self.stamps = (
            PERIOD_S * np.arange(_CUT),
            PERIOD_S * _CUT + np.sort(rng.uniform(0.0, PERIOD_S * (_CUT - 1), 1100)),
        )
        self.truth = rao_garnier.PARAMETERS
        self.clean = self._responses(self.truth)
        quiet = rao_garnier.noise_level(self.clean[0], snr_db)
        self.sigmas = (quiet, 3.0 * quiet)
        self.bound = self._limit()

    def _responses(self, parameters: np.ndarray) -> list[np.ndarray]:
        denominator = np.concatenate([[1.0], parameters[:4]])
        model = TransferFunctionModel(parameters[4:], denominator, 0.0, np.zeros((7, 7)), 0.0)
        whole = InputSignal("u", "", (0.0, PERIOD_S), self.drive)
        return [model.simulate(whole, stamps) for stamps in self.stamps]

    def _limit(self) -> np.ndarray:
        """Return the joint bound, with an unknown offset and an unknown initial state in both records."""
        slopes = []
        for i, value in enumerate(self.truth):
            step = np.zeros(6)
            step[i] = _STEP * abs(value)
            ahead, behind = self._responses(self.truth + step), self._responses(self.truth - step)
            slopes.append([(a - b) / (2.0 * step[i]) for a, b in zip(ahead, behind, strict=True)])
        poles = np.roots(np.concatenate([[1.0], self.truth[:4]]))
        poles = poles[poles.imag > 0.0]
        information = np.zeros((6, 6))
        for record, (stamps, sigma) in enumerate(zip(self.stamps, self.sigmas, strict=True)):
            columns = np.stack([own[record] for own in slopes], axis=1)
            decays = np.exp(np.outer(stamps - stamps[0], poles))
            own = np.linalg.qr(np.column_stack([np.ones_like(stamps), decays.real, decays.imag]))[0]
            columns = (columns - own @ (own.T @ columns)) / sigma
            information += columns.T @ columns
        return np.sqrt(np.diag(np.linalg.inv(information)))

    def records(self, seed: int) -> tuple[TimeRecord, TimeRecord]:
        """Return the two noisy records of one seed."""
        rng = np.random.default_rng(seed)
        made = []
        parts = zip(self.stamps, self.clean, self.sigmas, _OFFSETS, (0.0, _START_S), strict=True)
        for number, (stamps, clean, sigma, offset, start) in enumerate(parts):
            first = number * _CUT
            shift = start - PERIOD_S * first
            held = self.drive[first : first + _CUT]
            drive = InputSignal("u", "V", (start, PERIOD_S), held)
            noisy = clean + offset + sigma * rng.standard_normal(len(clean))
            output = OutputSignal("y", "m", stamps + shift, noisy)
            made.append(TimeRecord((drive,), (output,), name=("quiet", "loud")[number]))
        return made[0], made[1]

    def run(self, seed: int) -> Outcome:
        """Estimate from both records of one seed."""
        records = self.records(seed)
        start = time.perf_counter()
        if self.has_common_poles:
            joint = estimate_common_poles(records, 4, 1, has_offset=True, has_free_response=True)
            model, converged = joint.models[0], joint.converged
        else:
            found = estimate_transfer_function(records, 4, 1, has_offset=True, has_free_response=True)
            model, converged = found.model, found.converged
        seconds = time.perf_counter() - start
        if not converged:
            return Outcome(seconds)
        return Outcome(seconds, model.parameters[:6], model.standard_deviations[:6])


class TwoFilms(AgainstBound):
    """Two modes of a beam on a moved hub from two films, the second with six times the noise; their poles."""

    model = ModalModel(
        "base_motion", "hub", ("root", "tip"), 2 * np.pi * np.array([4.4, 28.3]), np.array([0.005, 0.005]),
        np.array([[0.01, -0.05], [1.5, -0.75]]), np.zeros(2), np.ones(2), 0.0, 0.0, np.zeros((14, 14)), np.ones(2),
    )  # fmt: skip
    sigmas = (4e-6, 2.4e-5)
    offsets = (0.0, 1e-3)
    exposure_s = 5e-3
    rate_sd = 50e-6  # what identify() takes the clocks' rate to be known to

    def __init__(self) -> None:
        chirp = LogChirp(start_frequency=1.0, end_frequency=45.0, duration=6.0, still=3.0).sample(1e-3)
        self.hub = chirp.input_signal("position", "hub")
        self.stamps = 0.01 * np.arange(1, 890)
        self.clean = self.model.simulate(self.hub, self.stamps, self.exposure_s)
        self.truth = np.concatenate([self.model.natural_frequencies, self.model.damping_ratios])

    @cached_property
    def bound(self) -> np.ndarray:
        """The joint bound on the poles: clocks, gains, residues, offsets, ramps and free motions unknown."""
        middle = self.stamps.mean()

        def outputs(parameters: np.ndarray) -> np.ndarray:
            omegas, zetas, (latency, rate), own = np.split(parameters, [2, 4, 6])
            gains, terms, *residues = own.reshape(4, 2)
            model = dataclasses.replace(
                self.model,
                natural_frequencies=omegas,
                damping_ratios=zetas,
                gains=gains,
                residual_terms=terms,
                residues=np.array(residues).T,
            )
            instants = middle + (self.stamps - latency - middle) / (1.0 + rate)
            return model.simulate(self.hub, instants, self.exposure_s)

        start = np.concatenate(
            [
                self.truth,
                [0.0, 0.0],
                self.model.gains,
                self.model.residual_terms,
                self.model.residues.T.ravel(),
            ]
        )
        steps = np.concatenate([1e-6 * self.truth, [1e-7, 1e-7], np.full(8, 1e-6)])
        slopes = []
        for k, step in enumerate(steps):
            change = np.zeros(len(start))
            change[k] = step
            slopes.append((outputs(start + change) - outputs(start - change)) / (2.0 * step))
        poles = self.truth[:2] * (-self.truth[2:] + 1j * np.sqrt(1.0 - self.truth[2:] ** 2))
        decays = np.exp(np.outer(self.stamps, poles))
        ramp = self.stamps - middle
        own = np.linalg.qr(np.column_stack([np.ones_like(ramp), ramp, decays.real, decays.imag]))[0]
        columns = np.array(slopes).transpose(2, 1, 0)  # (output, sample, parameter)
        columns = columns - own @ (own.T @ columns)
        information = np.sum([columns[j].T @ columns[j] for j in range(2)], axis=0)
        information = information * sum(sigma**-2 for sigma in self.sigmas)
        information[5, 5] += self.rate_sd**-2
        scale = 1.0 / np.sqrt(np.diag(information))
        covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
        return np.sqrt(np.diag(covariance))[:4]

    def records(self, seed: int, colour: float = 0.0) -> list[TimeRecord]:
        """Return the two films of one seed, under white noise or an AR(1) of the same power."""
        made = []
        for number, (sigma, offset) in enumerate(zip(self.sigmas, self.offsets, strict=True)):
            outputs = []
            for j, name in enumerate(self.model.output_names):
                noise = coloured(4 * seed + 2 * number + j, len(self.stamps), [1.0], [1.0, -colour])
                seen = self.clean[:, j] + offset + sigma * noise
                outputs.append(OutputSignal(name, "m", self.stamps, seen, self.exposure_s))
            made.append(TimeRecord((self.hub,), tuple(outputs), name=("quiet", "loud")[number]))
        return made

    def run(self, seed: int) -> Outcome:
        """Identify from both films of one seed; another number of modes is a failure."""
        records = self.records(seed)
        start = time.perf_counter()
        model = identify(records).model
        seconds = time.perf_counter() - start
        if model.n_modes != 2:
            return Outcome(seconds)
        sds = np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd])
        return Outcome(seconds, np.concatenate([model.natural_frequencies, model.damping_ratios]), sds)


STUDIES = {
    "two-records": Study("Rao-Garnier in two records of different noise", 1000, TwoRecords),
    "two-films": Study("modes from two films of different noise", 400, TwoFilms),
    "two-records-common-poles": Study(
        "the same by the estimator of common poles", 200, lambda: TwoRecords(has_common_poles=True)
    ),
}
