"""What an identification may be told: the parameters ``identifier.*``, read.

The rig's table of parameters (``beam_ros.interfaces.rig_parameters``) holds each option once, with its words, range
and description: ``beam identify`` makes its flags of it, the node ``identifier`` its parameters. Here the texts among
them become numbers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from beam_ident import EstimatorSettings, Prior
from beam_ident.estimators import NoiseChoice, Term
from beam_ident.numerics.piecewise import Hold
from beam_ros.errors import UsageError, suggestion
from beam_ros.interfaces.rig_parameters import IdentifierSettings
from beam_ros.process.remote_paths import AnyPath, any_path
from beam_ros.signals.descriptions import Signals

TERMS: tuple[Term, ...] = ("residual", "offset", "ramp", "free_response")


@dataclass(frozen=True)
class FitOptions:
    """How to identify.

    Attributes
    ----------
    estimator : str -- its name
    structure : str -- "auto": by the hub's command mode, or by what the signals are
    n_modes, max_modes : int or None
    orders : tuple of (n_poles, n_zeros)
    without : tuple of str -- terms that are left out of the model
    delay : Prior or None -- by how much the outputs' stamps are late [s]
    clock : Prior or None -- rate of the outputs' clock against the input's, less one
    hold : str or None -- what the input does between samples
    noise : str
    segments : tuple of (start, end) -- of each bag [s], from its first sample; empty: everything
    amplitude : bool -- also curves of frequency and damping over amplitude
    best_linear : bool -- also the best linear approximation, from bags of one multisine with other seeds
    axis : bool -- also mass and friction of the hub's axis
    drive_mass : float or None -- of a compliant drive of that axis, ahead of its spring [kg]
    encoder : str -- whose position the axis measures, "hub" or "drive"
    signals : Signals -- input and outputs that are not the rig's own
    time : str -- of a file of columns: which is the time, or at which rate its rows come
    """

    estimator: str = "modal"
    structure: str = "auto"
    n_modes: int | None = None
    max_modes: int | None = None
    orders: tuple[tuple[int, int], ...] = ()
    without: tuple[Term, ...] = ()
    delay: Prior | None = None
    clock: Prior | None = None
    hold: Hold | None = None
    noise: NoiseChoice = "auto"
    segments: tuple[tuple[float, float], ...] = ()
    amplitude: bool = False
    best_linear: bool = False
    axis: bool = False
    drive_mass: float | None = None
    encoder: str = "hub"
    signals: Signals = field(default_factory=Signals)
    time: str = ""

    @staticmethod
    def of(settings: IdentifierSettings) -> FitOptions:
        """Read the parameters.

        Raises
        ------
        UsageError, ParameterFileError
            A text among them is wrong.
        """
        return FitOptions(
            estimator=settings.estimator,
            structure=settings.structure,
            n_modes=settings.modes or None,
            max_modes=settings.max_modes or None,
            orders=tuple(_orders(settings.orders)),
            without=tuple(_terms(settings.without)),
            delay=_prior("delay", "s", settings.delay),
            clock=_prior("clock", "1, as 20e-6", settings.clock),
            hold=None if settings.hold == "auto" else settings.hold,
            noise=settings.noise,
            segments=tuple(_segments(settings.segments)),
            amplitude=settings.amplitude,
            best_linear=settings.best_linear,
            axis=settings.axis,
            drive_mass=settings.drive_mass or None,
            encoder=settings.encoder,
            signals=Signals.of(
                settings.input,
                listed(settings.outputs),
                Path(settings.signals) if settings.signals else None,
            ),
            time=settings.time,
        )

    def settings(self, structure: str, clock: Prior, latency: Prior | None) -> EstimatorSettings:
        """Return them for an estimator.

        Parameters
        ----------
        structure : str -- chosen
        clock : Prior -- what the bag says of it
        latency : Prior or None -- what it says of it
        """
        return EstimatorSettings(
            structure,  # type: ignore[arg-type]
            self.n_modes,
            self.clock or clock,
            latency=self.delay or latency,
            orders=self.orders,
            max_modes=self.max_modes,
            noise=self.noise,
            without=self.without,
        )


def listed(text: str) -> list[str]:
    """Return the parts of a text of several, which stand with ``;`` between."""
    return [part.strip() for part in text.split(";") if part.strip()]


def paths(text: str) -> list[AnyPath]:
    """Return the paths, or URLs, in a text of several."""
    return [any_path(part) for part in listed(text)]


def _words(text: str) -> list[str]:
    return [part for part in re.split(r"[,\s]+", text.strip()) if part]


def _orders(text: str) -> Iterator[tuple[int, int]]:
    for word in _words(text):
        match = re.fullmatch(r"(\d+)(?:/(\d+))?", word)
        if match is None:
            raise UsageError(
                f"orders {text!r}: {word!r} is none; expected poles/zeros with commas between, 4/3,5/4"
            )
        yield int(match[1]), int(match[2] or 0)


def _terms(text: str) -> Iterator[Term]:
    for word in _words(text):
        if word not in TERMS:
            raise UsageError(f"without {text!r}: no term is called {word!r}; {suggestion(word, TERMS)}")
        yield TERMS[TERMS.index(word)]


def _prior(name: str, unit: str, text: str) -> Prior | None:
    if text in ("", "auto"):
        return None
    if text == "free":
        return Prior(0.0, math.inf)
    mean, _, sd = text.partition("+-")
    try:
        return Prior(float(mean), float(sd) if sd else 0.0)
    except ValueError as err:
        raise UsageError(
            f"{name} is {text!r}; expected auto, free, a number [{unit}], or a number and its standard deviation as "
            "0.004+-0.001"
        ) from err


def _segments(text: str) -> Iterator[tuple[float, float]]:
    for word in _words(text):
        start, separator, end = word.partition(":")
        try:
            found = float(start or 0.0), float(end) if end else math.inf
        except ValueError:
            found = math.nan, math.nan
        if not separator or not found[0] < found[1]:
            raise UsageError(
                f"segments {text!r}: {word!r} is none; expected start:end in seconds with commas between, 0:10,12:20"
            )
        yield found
