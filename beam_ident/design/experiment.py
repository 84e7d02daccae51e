"""``design_experiment``: which excitation leaves the smallest uncertainty within the limits of axis and structure.

Spectrum, phases, level and the still share of the length are chosen for the camera at hand, from a model that theory
or the last identification gives, and robustly: for draws of what the poles may be. What comes out is a recipe, with
the standard deviations that the exact bound of the whole record predicts, beside those of the best chirp and the best
multisine of the same length and limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import InputSignal
from beam_ident.design.criteria import Criterion
from beam_ident.design.limits import ExcitationLimits
from beam_ident.design.precision import Observation, predicted_model
from beam_ident.design.refinement import LimitedLines, SeenLines, amplitudes_and_phases, refined
from beam_ident.design.spectrum import candidate_lines, optimal_powers
from beam_ident.design.standard import best_standard, louder
from beam_ident.errors import ExcitationError, ExcitationLimitError
from beam_ident.excitation.crest_optimisation import schroeder_phases
from beam_ident.excitation.multisine import ShapedMultisine
from beam_ident.excitation.recipe import Recipe
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure
from beam_ident.numerics.blas_threads import on_one_thread

Progress = Callable[[str, float], None]

_DRAWS = 16
_TRIED = 100  # chirps and multisines, about
_SEARCHED = 4  # of so many draws one, where only the best of many is looked for
_REACH_OF_DRAWS = 2.0  # standard deviations
_SHARES = (0.6, 0.8, 0.95)  # of the length, during which something moves
_FADE_S = 0.5
_SHARE_OF_ALL = 0.15  # of the power: it costs less than a tenth of one deviation
_CREST = 2.5  # that the phases will reach about, of every quantity
_MIN_CYCLES = 8.0  # of the slowest mode in the excited part
_UNKNOWN = 0.5  # of a damping ratio: known worse it is not known
_UNSEEN = 1e-6  # of the largest response of any mode to a line on its resonance
_QUANTITIES = {"base_motion": "position", "velocity": "velocity", "acceleration": "acceleration"}
_DIGITS = 5


@dataclass(frozen=True, eq=False)
class PredictedExcitation:
    """One excitation within the limits, and what it is predicted to tell.

    Attributes
    ----------
    recipe : Recipe
    predicted : ModalModel -- the model with the covariance after the experiment
    value : float -- of the criterion: a relative standard deviation
    shares : dict of str to float -- predicted peak of every limited quantity over its limit
    """

    recipe: Recipe
    predicted: ModalModel
    value: float
    shares: dict[str, float]

    @property
    def pole_sd(self) -> dict[str, float]:
        """Relative standard deviations of natural frequencies and damping ratios, by their parameters' names."""
        n = 2 * self.predicted.n_modes
        sd = self.predicted.standard_deviations[:n] / np.abs(self.predicted.parameters[:n])
        return dict(zip(self.predicted.parameter_names[:n], sd.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class ExperimentDesign:
    """An optimal excitation beside the best usual ones of the same length under the same limits.

    Attributes
    ----------
    criterion : Criterion
    optimal, chirp, multisine : PredictedExcitation
    """

    criterion: Criterion
    optimal: PredictedExcitation
    chirp: PredictedExcitation
    multisine: PredictedExcitation

    @property
    def recipe(self) -> ShapedMultisine:
        """The designed excitation."""
        assert isinstance(self.optimal.recipe, ShapedMultisine)
        return self.optimal.recipe

    @property
    def gain(self) -> float:
        """The criterion over that of the best chirp: below 1 is better; its square is the share of the time."""
        return self.optimal.value / self.chirp.value

    @property
    def worst_parameter(self) -> str:
        """Name of the pole's parameter that the best chirp knows worst, or of c's."""
        return self.criterion.parameter or max(self.chirp.pole_sd, key=self.chirp.pole_sd.__getitem__)

    @property
    def worst_gain(self) -> float:
        """The standard deviation of the worst-known parameter over that after the best chirp."""
        place = self.optimal.predicted.parameter_names.index(self.worst_parameter)
        sds = (own.predicted.standard_deviations[place] for own in (self.optimal, self.chirp))
        return float(next(sds) / next(sds))

    def __str__(self) -> str:
        """Return the standard deviations side by side as lines of text."""
        every = {"optimal": self.optimal, "best chirp": self.chirp, "best multisine": self.multisine}
        lines = [
            f"{self.criterion}-optimal excitation: {len(self.recipe.frequencies)} lines over "
            f"{self.recipe.duration:.4g} s, {self.recipe.still:.4g} s still",
            f"{'relative standard deviation':<28}" + "".join(f"{name:>16}" for name in every),
        ]
        for name in self.optimal.pole_sd:
            lines.append(f"{name:<28}" + "".join(f"{own.pole_sd[name]:>16.3g}" for own in every.values()))
        lines.append(
            f"{'criterion ' + str(self.criterion):<28}"
            + "".join(f"{own.value:>16.3g}" for own in every.values())
        )
        for name in self.optimal.shares:
            row = "".join(f"{100.0 * own.shares[name]:>15.0f}%" for own in every.values())
            lines.append(f"{'peak ' + name + ' of its limit':<28}{row}")
        lines.append(
            f"{self.worst_parameter}, which the best chirp knows worst, is known to {self.worst_gain:.2g} of the "
            f"chirp's standard deviation; the chirp would need some {self.gain**-2:.2g} times the length for the "
            "same criterion"
        )
        return "\n".join(lines)


@on_one_thread
def design_experiment(
    model: ModalModel,
    limits: ExcitationLimits,
    observation: Observation,
    duration_s: float,
    band_hz: tuple[float, float],
    criterion: str = "D",
    *,
    frequency_sd: float = 0.0,
    damping_sd: float = 0.0,
    margin: float = 0.95,
    seed: int = 1,
    progress: Progress = lambda phrase, share: None,
) -> ExperimentDesign:
    """Return the excitation within the limits that leaves the smallest uncertainty.

    Parameters
    ----------
    model : ModalModel
        What is known beforehand: theory or an identification, of one input. All its modes lie within the band. The
        covariance of its poles counts as uncertainty.
    limits : ExcitationLimits -- of axis and structure
    observation : Observation -- how the outputs will be seen
    duration_s : float -- of excitation and still stretch together [s]
    band_hz : tuple of float -- in which lines may lie [Hz]
    criterion : str
        ``D`` (natural frequencies and damping ratios together), ``A`` (their mean relative variance) or ``c:NAME``,
        one of the model's ``parameter_names``.
    frequency_sd, damping_sd : float
        Relative standard deviations of natural frequencies and damping ratios, besides the model's covariance.
    margin : float -- of every limit that may be used
    seed : int -- of the draws of the poles
    progress : callable -- called with a phrase and the share done

    Raises
    ------
    ExcitationError
        A mode out of the band, that nothing drives or that no output sees; a length too short; an unknown criterion.
    ExcitationLimitError
        Within the limits nothing stands out of the noise.

    Notes
    -----
    Which lines there are follows from a convex design of long records (``design.spectrum``); their amplitudes and
    phases are then refined on the record from rest to its end (``design.refinement``). What is stated is the exact
    bound of the sampled record, and the level is found from the exact peaks, the largest over the draws.
    """
    task = _Design(model, limits, observation, duration_s, band_hz, Criterion.of(criterion), margin)
    task.check()
    task.draw(frequency_sd, damping_sd, seed)
    tried = []
    for number, share in enumerate(_SHARES):
        progress("spectrum and phases", 0.5 * number / len(_SHARES))
        tried.append(task.shaped(round(share * duration_s, 3)))
    optimal = min(tried, key=lambda own: own.value)
    task.refuse_unknown(optimal)
    modes_hz = float(np.min(model.frequencies_hz)), float(np.max(model.frequencies_hz))
    best = {}
    n_tried = 0

    def value(recipe: Recipe) -> tuple[float, Recipe]:
        nonlocal n_tried
        n_tried += 1
        progress("the best chirp and multisine", 0.5 + 0.5 * min(1.0, n_tried / _TRIED))
        return task.standard(recipe)

    for kind in ("chirp", "multisine"):
        _, recipe = best_standard(kind, band_hz, modes_hz, duration_s, _SHARES, value)
        best[kind] = task.candidate(task.loudest_of(recipe))
    progress("done", 1.0)
    return ExperimentDesign(task.criterion, optimal, best["chirp"], best["multisine"])


class _Design:
    """What ``design_experiment`` was asked for, and the steps of the answer."""

    def __init__(
        self,
        model: ModalModel,
        limits: ExcitationLimits,
        observation: Observation,
        duration_s: float,
        band_hz: tuple[float, float],
        criterion: Criterion,
        margin: float,
    ) -> None:
        self.model, self.limits, self.observation = model, limits, observation
        self.duration_s, self.band_hz, self.criterion, self.margin = duration_s, band_hz, criterion, margin
        self.models, self.limits_of = [model], [limits]

    def check(self) -> None:
        """Raise ExcitationError where no design can be made from what was given."""
        model, (low, high) = self.model, self.band_hz
        if model.further_inputs or not model.n_modes:
            raise ExcitationError(
                f"the model has {model.n_modes} modes and the inputs {', '.join(model.input_names)}; expected at "
                "least one mode and one input: give path() of one"
            )
        self.observation.noise_of(model.output_names)
        if not np.all(model.damping_ratios > 0.0):
            raise ExcitationError(
                f"damping ratios are {', '.join(f'{z:.3g}' for z in model.damping_ratios)}; expected numbers above "
                "0: give the model damping, or leave a mode without it out"
            )
        nyquist = 0.5 / self.limits.period_s
        if not 0.0 < low < high <= nyquist:
            raise ExcitationError(
                f"band_hz is {self.band_hz}; expected 0 < low < high <= {nyquist:g} Hz, half the rate of the hold"
            )
        if not 0.0 < self.margin <= 1.0:
            raise ExcitationError(f"margin is {self.margin!r}; expected a number above 0, at most 1")
        if self.criterion.kind == "c":
            self.criterion.place(model)
        outside = [f"{f:.4g}" for f in model.frequencies_hz if not low < f < high]
        if outside:
            raise ExcitationError(
                f"modes at {', '.join(outside)} Hz lie outside the band of {low:g} to {high:g} Hz; widen the band, "
                "or leave them out of the model"
            )
        if not self.limits.names:
            raise ExcitationError(
                "no quantity has a limit; expected at least one: an acceleration, a tip's way"
            )
        shortest = _MIN_CYCLES / (_SHARES[0] * float(np.min(model.frequencies_hz)))
        if not self.duration_s >= shortest:
            raise ExcitationError(
                f"duration_s is {self.duration_s!r}; expected at least {shortest:.3g} s, in which the mode at "
                f"{np.min(model.frequencies_hz):.4g} Hz shows its damping: make it longer"
            )
        self._refuse_unseen()

    def _refuse_unseen(self) -> None:
        """Raise ExcitationError for a mode that nothing drives, or that no output shows."""
        model = self.model
        size = np.abs(model.residues) / (2.0 * np.abs(model.damping_ratios) * model.natural_frequencies**2)
        blur = np.sinc(model.frequencies_hz * self.observation.exposure_s)
        seen = np.max(size, axis=0) * np.abs(blur)
        for k in np.flatnonzero(seen < _UNSEEN * np.max(seen)):
            reason = (
                f"the exposure of {self.observation.exposure_s:g} s averages whole cycles of it: shorten it"
                if abs(blur[k]) < 1e-3
                else "nothing drives it, or every output lies on one of its nodes: drive or look elsewhere"
            )
            raise ExcitationError(
                f"the mode at {model.frequencies_hz[k]:.4g} Hz shows in no output: {reason}, or leave it out of the "
                "model"
            )

    def draw(self, frequency_sd: float, damping_sd: float, seed: int) -> None:
        """Add draws of what the poles may be, spread evenly over their distribution."""
        for name, sd in (("frequency_sd", frequency_sd), ("damping_sd", damping_sd)):
            if not 0.0 <= sd < 1.0:
                raise ExcitationError(
                    f"{name} is {sd!r}; expected a relative standard deviation from 0 below 1"
                )
        model, n = self.model, self.model.n_modes
        scale = 1.0 / model.parameters[: 2 * n]
        covariance = model.covariance[: 2 * n, : 2 * n] * np.outer(scale, scale)
        covariance = covariance + np.diag(np.repeat(np.square([frequency_sd, damping_sd]), n))
        if not np.any(covariance):
            return
        values, axes = np.linalg.eigh(covariance)
        root = axes * np.sqrt(np.maximum(values, 0.0))
        for own in evenly_drawn(_DRAWS, 2 * n, seed):
            factors = np.exp(root @ own)
            moved = replace(
                model,
                natural_frequencies=model.natural_frequencies * factors[:n],
                damping_ratios=np.minimum(model.damping_ratios * factors[n:], 0.999),
            )
            self.models.append(moved)
            self.limits_of.append(self.limits.with_poles(model, moved))

    def shaped(self, active_s: float) -> PredictedExcitation:
        """Return the best shaped multisine that moves for ``active_s``."""
        lines = candidate_lines(self.models, self.band_hz, active_s, self.observation.rate_hz)
        crests = np.full(len(self.limits.names), _CREST)
        known = (self.models, lines, self.limits_of, crests, active_s, self.observation)
        powers = optimal_powers(self.criterion, *known)
        if self.criterion.kind != "D":
            # Alone, what is best for one parameter may leave others unknown that it is to be told apart from.
            powers = (1.0 - _SHARE_OF_ALL) * powers + _SHARE_OF_ALL * optimal_powers(Criterion("D"), *known)
        kept = powers > 0.0
        effective, phases = np.sqrt(powers[kept]), schroeder_phases(np.sqrt(powers[kept]))
        recipe = self._recipe(lines[kept], effective, phases, active_s)
        few = slice(None, None, _SEARCHED)
        seen = [SeenLines(own, recipe, self.limits, self.observation) for own in self.models[few]]
        start = np.concatenate([effective * np.cos(phases), effective * np.sin(phases)])
        limited = LimitedLines(recipe, self.limits_of[few])
        effective, phases = amplitudes_and_phases(refined(self._criteria(), seen, limited, start), limited)
        audible = effective > 0.0
        recipe = self._recipe(lines[kept][audible], effective[audible], phases[audible], active_s)
        return self.candidate(self.loudest_of(recipe))

    def _criteria(self) -> list[tuple[float, Criterion, FloatArray]]:
        """Return the criterion with what counts for it, and D beside another."""
        every = np.eye(len(self.model.parameter_names))
        of_all = Criterion("D"), every[:, : 2 * self.model.n_modes]
        if self.criterion.kind == "D":
            return [(1.0, *of_all)]
        own = of_all[1] if self.criterion.kind == "A" else every[:, [self.criterion.place(self.model)]]
        return [(1.0 - _SHARE_OF_ALL, self.criterion, own), (_SHARE_OF_ALL, *of_all)]

    def _recipe(
        self, lines_hz: FloatArray, effective: FloatArray, phases: FloatArray, active_s: float
    ) -> ShapedMultisine:
        """Return the recipe of some lines, in few digits."""
        shares = effective / np.max(effective)
        rounded = [round(float(share), _DIGITS - math.floor(math.log10(share))) for share in shares]
        return ShapedMultisine(
            tuple(np.round(lines_hz, _DIGITS).tolist()),
            tuple(rounded),
            tuple(np.round(phases, _DIGITS).tolist()),
            1.0,
            active_s,
            min(_FADE_S, active_s / 4),
            round(self.duration_s - active_s, 6),
        )

    def loudest_of(self, recipe: Any, every: int = 1) -> Any:
        """Return a recipe at the largest level within all limits, for the model and every so many draws."""
        accelerations = recipe.sample(self.limits.period_s).accelerations
        peaks = [np.max(np.abs(own.over_time(accelerations)), initial=0.0) for own in self.limits_of[::every]]
        factor = self.margin / float(max(peaks))
        if isinstance(recipe, ShapedMultisine):
            return replace(recipe, acceleration=_rounded_down(factor * recipe.acceleration))
        return louder(recipe, factor)

    def standard(self, recipe: Recipe) -> tuple[float, Recipe]:
        """Return the criterion of a usual excitation at its largest level, and that recipe."""
        loudest = self.loudest_of(recipe, _SEARCHED)
        return self.criterion.value(self._predicted(loudest)), loudest

    def candidate(self, recipe: Recipe) -> PredictedExcitation:
        """Return an excitation with what it is predicted to tell and to use of the limits."""
        predicted = self._predicted(recipe)
        return PredictedExcitation(
            recipe, predicted, self.criterion.value(predicted), self.limits.shares(recipe)
        )

    def _predicted(self, recipe: Recipe) -> ModalModel:
        return predicted_model(self.model, drive_of(recipe, self.model, self.limits), self.observation)

    def refuse_unknown(self, found: PredictedExcitation) -> None:
        """Raise ExcitationLimitError where even the best excitation leaves something unknown."""
        names = [self.criterion.parameter] if self.criterion.parameter else list(found.pole_sd)
        sds = found.predicted.standard_deviations / np.maximum(np.abs(found.predicted.parameters), 1e-300)
        relative = {name: float(sds[found.predicted.parameter_names.index(name)]) for name in names}
        worst = max(relative, key=relative.__getitem__)
        if relative[worst] > _UNKNOWN:
            limiting = max(found.shares, key=found.shares.__getitem__)
            factor = relative[worst] / _UNKNOWN
            raise ExcitationLimitError(
                f"no excitation within the limits shows {worst}: its standard deviation stays at "
                f"{100.0 * relative[worst]:.3g} % of it, expected at most {100.0 * _UNKNOWN:g} %; the limit of "
                f"{limiting} binds. Raise it by a factor of {factor:.2g}, lower the noise by as much, record "
                f"{factor**2:.2g} times as long, or leave the mode out of the model"
            )


def evenly_drawn(n_draws: int, n_parameters: int, seed: int) -> FloatArray:
    """Return standard normal draws within two deviations, spread evenly, shape (n_draws, n_parameters)."""
    from scipy.special import ndtri

    rng = np.random.default_rng(seed)
    places = (np.arange(n_draws) + 0.5) / n_draws
    normal = np.clip(ndtri(places), -_REACH_OF_DRAWS, _REACH_OF_DRAWS)
    return np.stack([rng.permutation(normal) for _ in range(n_parameters)], axis=1)


def drive_of(recipe: Recipe, model: ModalModel, limits: ExcitationLimits) -> InputSignal:
    """Return what a recipe makes the model's input do."""
    if ModalStructure(model.structure).is_motion:
        sampled = recipe.sample(limits.period_s)
        return sampled.input_signal(_QUANTITIES[model.structure], model.input_name)  # type: ignore[arg-type]
    return recipe.sample_input(limits.period_s, limits.scale, "N", model.input_name).input_signal()


def _rounded_down(value: float) -> float:
    """Return a number with few digits just below a positive one."""
    digits = _DIGITS - math.floor(math.log10(value))
    return round(math.floor(value * 10.0**digits) / 10.0**digits, digits)
