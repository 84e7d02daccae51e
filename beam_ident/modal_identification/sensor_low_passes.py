"""Low-passes that sensors have of their own: found in what a model without them leaves, and estimated beside it.

A laser that averages, an amplifier with a filter, an exposure that nobody stated: all of them pass what is slow,
and show it late. A delay makes up for the lateness and the poles bend for the rest; close to where the low-pass
acts a mode is found that is not there. With ``log F(s) = -lag s + (lag^2/2 - bend) s^2 + ..`` what a delay leaves
are the second and the third derivative of the model by time: a score test for both says whether to look.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.arrays import FloatArray
from beam_ident.data.own_clocks import with_low_passes
from beam_ident.data.prior import Prior
from beam_ident.data.records import LowPass, TimeRecord, busiest_stretch
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal_estimation.mode_search import SHORT
from beam_ident.modal_estimation.record_levels import output_speeds
from beam_ident.modal_estimation.variable_projection import fit_modes
from beam_ident.modal_identification.fit_tests import SampledFit
from beam_ident.noise.autoregression import autoregression
from beam_ident.noise.scores import ScoreTest, Whiteness
from beam_ident.numerics.convolution import causal_convolution
from beam_ident.sensing.misfit_causes import misfit_warnings

_LEVEL = 1e-3  # how often an output without a low-pass is looked at, and said to have one
_STEP = 0.1  # radians of the fastest mode: of differences by time
_LAGS = 2.0 ** np.arange(-4, 3)  # radians of the fastest mode by which a low-pass may be late
_SHAPES = (1.0 / 3.0, 0.5)  # bend over square of lag: the mean over an exposure, and Butterworth
_MIN_SHAPE, _MAX_SHAPE = 1e-3, 1.0
_MAX_SAMPLES = 2_000  # of an output that tell
_MAX_LEFT_OUT = 3  # modes
_NEXT_TO_NOTHING = 0.2  # of the square of what was left
_MAX_FACTOR = 2.0  # by which a step changes a lag at most: the lags that it begins at are so far apart
_STEPS, _HALVINGS = 12, 5
_SETTLED = (
    0.01  # in log-likelihood: a step that gains less moves nothing by a sixth of its standard deviation
)
_SMALL = 1e-3  # of a lag: a step that is a derivative


@dataclass(frozen=True, eq=False)
class Sensor:
    """What an output by itself shows of its sensor.

    Attributes
    ----------
    low_pass : LowPass
    left : float -- what is left of the square of what a fit without the low-pass leaves
    modes : ModalFit -- behind the low-pass, with a clock by itself
    """

    low_pass: LowPass
    left: float
    modes: ModalFit


def suspected(some: SampledFit, known: Collection[str]) -> list[str]:
    """Return the outputs that may have a low-pass of their own.

    Parameters
    ----------
    some : SampledFit
    known : collection of str -- outputs that are left out
    """
    if not len(some.fit.omegas):
        return []
    level = _LEVEL / some.regression.n_outputs
    return [
        name
        for (name, test), left in zip(_curvature_tests(some).items(), some.fit.residuals, strict=True)
        # Weights may take what is wrong for a colour of the noise, and then no test sees it.
        if name not in known and (test.p_value < level or not Whiteness.of(left).is_white)
    ]


def _curvature_tests(some: SampledFit) -> dict[str, ScoreTest]:
    """Return of every output the test of whether what is left holds derivatives of the model by time."""
    regression, fit = some.regression, some.fit
    step = _STEP / float(fit.omegas[-1])
    speeds = []
    for moved in (0.0, -step, step):
        clock = replace(fit.clock, latency=fit.clock.latency - moved)
        speeds.append(output_speeds(regression, fit.omegas, fit.zetas, clock, fit.coefficients))
    tests = {}
    for j, name in enumerate(regression.output_names):
        now, before, after = (own[j] for own in speeds)
        columns = np.stack([after - before, after - 2.0 * now + before], axis=1)
        tests[name] = ScoreTest.of([(columns, some.solutions[j], fit.residuals[j], regression.values[j])])
    return tests


def likely_low_pass(
    records: Sequence[TimeRecord],
    regression: ModalRegression,
    fit: ModalFit,
    name: str,
    late_s: float,
    clock_rate: Prior,
) -> Sensor | None:
    """Return the low-pass that an output by itself shows, or None.

    Parameters
    ----------
    records : sequence of TimeRecord -- with the output's stamps as they were measured
    regression : ModalRegression -- of them
    fit : ModalFit
    name : str
    late_s : float -- how late the output's stamps are where it has no low-pass
    clock_rate : Prior

    Notes
    -----
    It is believed where it explains more than noise of the colour that it leaves would, and leaves next to nothing;
    or white noise, with fewer modes or of what looks like no other cause: modes that are missing, a bent sensor, or a
    clock that runs look a little like a low-pass.  Modes that are not needed beside it are left out, the weakest
    first: one may stand for what it does.
    """
    alone = _Alone(records, regression, name, (Prior(0.0, math.inf), clock_rate))
    before = alone.fitted(None, replace(fit, clock=ClockState(late_s, fit.clock.rate)))
    if not alone.is_curved(before):
        return None
    strongest = np.argsort(-alone.strengths(before), kind="stable")
    best: _Trial | None = None
    for n_modes in range(max(len(strongest) - _MAX_LEFT_OUT, 1), len(strongest) + 1):
        kept = strongest[:n_modes]
        modes = replace(before, omegas=before.omegas[kept], zetas=before.zetas[kept])
        trial = alone.refined(alone.start(modes, (0.0,)), 1)
        if not Whiteness.of(trial.fit.residuals[0]).is_white:
            trial = min(trial, alone.refined(alone.start(modes, _SHAPES), 2), key=_Trial.bic)
        if best is not None and best.bic() < trial.bic():
            break
        best = trial
    assert best is not None
    left, without = best.fit.residuals[0], before.residuals[0]
    share = float(left @ left) / max(float(without @ without), 1e-300)
    if not _explains(before, best.fit):
        return None
    if share >= _NEXT_TO_NOTHING:
        if not Whiteness.of(left).is_white:
            return None
        needs_fewer = len(best.fit.omegas) < len(before.omegas)
        if not needs_fewer and alone.has_other_cause(name, without):
            return None
    return Sensor(best.low_pass, share, best.fit)


def _explains(before: ModalFit, after: ModalFit) -> bool:
    """Return whether less is left than chance would leave, under noise of the colour of what is left."""
    colour = autoregression(after.residuals[0])
    white = [causal_convolution(colour, own.residuals[0]) for own in (before, after)]
    powers = [float(np.sum(np.square(own))) for own in white]
    n = len(after.residuals[0])
    return bool(n * math.log(powers[0] / max(powers[1], 1e-300)) > chi_squared_isf(2, _LEVEL))


@dataclass(frozen=True, eq=False)
class _Trial:
    """A low-pass, and the fit of modes and clock behind it."""

    low_pass: LowPass
    fit: ModalFit

    def bic(self) -> float:
        """Return Bayes' criterion."""
        n_parameters = self.fit.n_parameters + 1 + (self.low_pass.bend_s2 > 0.0)
        return 2.0 * self.fit.cost + n_parameters * math.log(len(self.fit.residuals[0]))


class _Alone:
    """One output by itself.

    Parameters
    ----------
    records, regression, name : as of ``likely_low_pass``
    clocks : tuple of Prior -- of its latency and clock rate
    """

    def __init__(
        self,
        records: Sequence[TimeRecord],
        regression: ModalRegression,
        name: str,
        clocks: tuple[Prior, Prior],
    ) -> None:
        own = [one.select([name]) for one in records if name in one.output_names]
        self._records = [busiest_stretch(one, _MAX_SAMPLES) for one in own]
        self._terms = replace(regression.structure, has_free_response=True)
        self._input_names, self._clocks = regression.input_names, clocks

    def _behind(self, low_pass: LowPass | None) -> list[TimeRecord]:
        """Return the records of the output behind a low-pass."""
        outputs = [replace(one.outputs[0], low_pass=low_pass) for one in self._records]
        return [replace(one, outputs=(own,)) for one, own in zip(self._records, outputs, strict=True)]

    def _through(self, low_pass: LowPass | None) -> ModalRegression:
        """Return the regression of the output behind a low-pass."""
        return ModalRegression(self._behind(low_pass), self._terms, self._input_names)

    def fitted(self, low_pass: LowPass | None, start: ModalFit) -> ModalFit:
        """Return the fit of modes and clock behind a low-pass."""
        problem = self._through(low_pass)
        return fit_modes(problem, start.omegas, start.zetas, start.clock, *self._clocks, SHORT)

    def is_curved(self, fit: ModalFit) -> bool:
        """Return whether what a fit without a low-pass leaves says that there is one."""
        (test,) = _curvature_tests(SampledFit.of(self._through(None), fit, *self._clocks)).values()
        return test.p_value < _LEVEL

    def has_other_cause(self, name: str, left: FloatArray) -> bool:
        """Return whether what a fit without a low-pass leaves looks like another cause."""
        plain = self._through(None)
        values = plain.values[0] - left
        parts = [(plain.times[0][own], values[own], left[own]) for _, own in plain.segments[0]]
        return bool(misfit_warnings([(name, parts)]))

    def strengths(self, fit: ModalFit) -> FloatArray:
        """Return how much every mode of a fit without a low-pass moves the output."""
        regression = self._through(None)
        (block,) = regression.blocks(fit.omegas, fit.zetas, fit.clock, gradients=False)
        modes = slice(regression.n_shared_fixed, regression.n_shared_fixed + len(fit.omegas))
        return np.asarray(np.abs(fit.coefficients[0][modes]) * np.linalg.norm(block.matrix[:, modes], axis=0))

    def start(self, modes: ModalFit, shapes: Sequence[float]) -> _Trial:
        """Return the low-pass of some shapes that leaves least of a grid, near modes behind none."""
        trials = []
        for lag in (_LAGS / modes.omegas[-1]).tolist():
            clock = replace(modes.clock, latency=modes.clock.latency - lag)
            for shape in shapes:
                low_pass = LowPass(lag, shape * lag**2)
                trials.append(_Trial(low_pass, self.fitted(low_pass, replace(modes, clock=clock))))
        return min(trials, key=lambda own: own.fit.cost)

    def refined(self, start: _Trial, order: int) -> _Trial:
        """Return the low-pass of first or second order that leaves least, near some start.

        Notes
        -----
        Lag and bend, clock and poles make up for each other: every step solves for all of them, the low-pass to first
        order (Gauss-Newton), and is halved until less is left.
        """
        best = start
        for _ in range(_STEPS):
            problem = self._through(best.low_pass)
            columns = low_pass_columns(
                problem, self._behind(best.low_pass), best.fit, problem.output_names[0]
            )
            beside = problem.with_own_columns({0: columns[:, :order]})
            joint = fit_modes(beside, best.fit.omegas, best.fit.zetas, best.fit.clock, *self._clocks, SHORT)
            step, before = joint.coefficients[0][-order:], best.fit.cost
            for share in 0.5 ** np.arange(_HALVINGS):
                trial = self._stepped(best, joint, share * step)
                if trial.fit.cost < before:
                    best = trial
                    break
            if not before - best.fit.cost > _SETTLED:
                break
        return best

    def _stepped(self, before: _Trial, joint: ModalFit, step: FloatArray) -> _Trial:
        """Return a fit behind a low-pass that is moved by a step of lag, and of bend, within their ranges."""
        known = before.low_pass
        lag = known.lag_s * float(np.clip(1.0 + step[0] / known.lag_s, 1.0 / _MAX_FACTOR, _MAX_FACTOR))
        bend = known.bend_s2 + float(step[1]) if len(step) > 1 else 0.0
        low_pass = LowPass(lag, min(max(bend, _MIN_SHAPE * lag**2 * (len(step) > 1)), _MAX_SHAPE * lag**2))
        return _Trial(low_pass, self.fitted(low_pass, joint))


def low_pass_columns(
    regression: ModalRegression, records: Sequence[TimeRecord], fit: ModalFit, name: str
) -> FloatArray:
    """Return the derivatives of the model of an output by lag and bend, if any, of its low-pass, unweighed.

    Parameters
    ----------
    regression : ModalRegression
    records : sequence of TimeRecord -- of it, in which the output has a low-pass
    fit : ModalFit
    name : str
    """
    low_pass = next(own.low_pass for one in records for own in one.outputs if own.name == name)
    assert low_pass is not None
    steps = _SMALL * low_pass.lag_s, _SMALL * low_pass.lag_s**2
    ways = [low_pass, replace(low_pass, lag_s=low_pass.lag_s + steps[0])]
    if low_pass.bend_s2 > 0.0:
        ways.append(replace(low_pass, bend_s2=low_pass.bend_s2 + steps[1]))
    said = []
    for own in ways:
        moved = ModalRegression(
            with_low_passes(records, {name: own}),
            regression.structure,
            regression.input_names,
            None,
            regression.restarts,
        )
        j = moved.output_names.index(name)
        parts = [
            piece.blocks(fit.omegas, fit.zetas, fit.clock, gradients=False)[piece.block_of[j]].matrix
            for piece in moved.pieces
        ]
        said.append(np.concatenate([part @ fit.coefficients[j][: part.shape[1]] for part in parts]))
    return np.stack(
        [(own - said[0]) / step for own, step in zip(said[1:], steps[: len(ways) - 1], strict=True)], axis=1
    )
