"""The stabilisation chart: which poles come back order after order, and the automatic choice among them.

Poles of the structure appear at every order that is high enough, with the same frequency, damping
and shape; poles that the order made up wander.  A pole is compared with its nearest neighbour of
the order below; runs of stable poles are gathered by frequency and shape, and those that
last through enough orders are taken for modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import require_frequency_record
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.errors import EstimationError
from beam_ident.modal_analysis.mode_indicators import complex_mode_indicator
from beam_ident.modal_analysis.polyreference import (
    OrderPoles,
    frequencies_and_damping,
    polyreference_poles,
    residues_at,
)
from beam_ident.modal_analysis.shapes import modal_assurance
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.summary import Summarised, SummaryPart, SummaryTable

ResponseForm = Literal["receptance", "mobility", "accelerance"]
DIFFERENTIATIONS: dict[str, int] = {"receptance": 0, "mobility": 1, "accelerance": 2}

NEW, FREQUENCY, DAMPING, STABLE = 0, 1, 2, 3


@dataclass(frozen=True)
class StabilityCriteria:
    """When a pole counts as that of the order below.

    Parameters
    ----------
    frequency : float -- largest relative change of the natural frequency
    damping : float -- largest relative change of the damping ratio
    shape : float -- least modal assurance between the residue shapes
    max_damping : float -- poles damped more are left out
    share : float -- of the orders through which a mode must last, from its first on
    """

    frequency: float = 0.01
    damping: float = 0.10
    shape: float = 0.95
    max_damping: float = 0.3
    share: float = 0.5

    def __post_init__(self) -> None:
        for name in ("frequency", "damping", "shape", "max_damping", "share"):
            value = getattr(self, name)
            if not 0.0 < value <= 1.0:
                raise EstimationError(
                    f"stability criteria: {name} is {value}; expected above 0 and at most 1"
                )


@dataclass(frozen=True, eq=False)
class ChartPole:
    """One pole of the chart: its order, frequency [rad/s], damping ratio, shape and how stable it is."""

    order: int
    natural_frequency: float
    damping_ratio: float
    shape: ComplexArray
    stability: int


@dataclass(frozen=True, eq=False, repr=False)
class StabilisationChart(Summarised):
    """Poles over orders, with the mode indicator and the modes that were chosen.

    Attributes
    ----------
    record : FrequencyRecord
    form : {"receptance", "mobility", "accelerance"}
    poles : tuple of ChartPole -- by order, then frequency
    indicator : ndarray, shape (n_lines, n) -- complex mode indicator of the record
    natural_frequencies, damping_ratios : ndarray, shape (n_modes,)
        The automatic choice: medians over the orders through which a mode lasts [rad/s], [-].
    lasting : ndarray of int, shape (n_modes,) -- through how many orders
    """

    record: FrequencyRecord
    form: ResponseForm
    poles: tuple[ChartPole, ...]
    indicator: FloatArray
    natural_frequencies: FloatArray
    damping_ratios: FloatArray
    lasting: IndexArray

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        rows = zip(self.frequencies_hz, self.damping_ratios, self.lasting, strict=True)
        cells = ((f"{hertz:.6g}", f"{100.0 * zeta:.4g}", str(orders)) for hertz, zeta, orders in rows)
        return [
            f"{len(self.poles)} poles over all orders; modes that last:",
            SummaryTable(("f [Hz]", "zeta [%]", "orders"), tuple(cells)),
        ]

    @property
    def frequencies_hz(self) -> FloatArray:
        """Chosen natural frequencies [Hz]."""
        return np.asarray(self.natural_frequencies / (2.0 * np.pi))


def checked_form(form: str) -> int:
    """Return how many times a form of response is differentiated, or raise EstimationError."""
    if form not in DIFFERENTIATIONS:
        raise EstimationError(f"form is {form!r}; expected one of {', '.join(DIFFERENTIATIONS)}")
    return DIFFERENTIATIONS[form]


@on_one_thread
def stabilisation_chart(
    record: FrequencyRecord,
    form: ResponseForm = "receptance",
    max_order: int = 30,
    criteria: StabilityCriteria | None = None,
) -> StabilisationChart:
    """Estimate poles of all orders, compare them and choose the modes.

    Parameters
    ----------
    record : FrequencyRecord -- lines that were not measured are left out
    form : {"receptance", "mobility", "accelerance"} -- what the response is
    max_order : int -- of the matrix polynomial; about twice to five times the number of modes
    criteria : StabilityCriteria or None -- None takes the defaults

    Raises
    ------
    EstimationError
        An order that the lines cannot carry, an unknown form.
    """
    require_frequency_record(record)
    record = record.measured()
    differentiations = checked_form(form)
    rules = StabilityCriteria() if criteria is None else criteria
    columns: list[list[ChartPole]] = []
    for found in polyreference_poles(record, max_order):
        before = columns[-1] if columns else []
        columns.append(_classified(record, found, differentiations, before, rules))
    poles = tuple(pole for column in columns for pole in column)
    omegas, zetas, lasting = _modes(poles, max_order, rules)
    return StabilisationChart(record, form, poles, complex_mode_indicator(record), omegas, zetas, lasting)


def _classified(
    record: FrequencyRecord,
    found: OrderPoles,
    differentiations: int,
    before: list[ChartPole],
    rules: StabilityCriteria,
) -> list[ChartPole]:
    omegas, zetas = frequencies_and_damping(found.poles)
    keep = zetas <= rules.max_damping
    poles, omegas, zetas = found.poles[keep], omegas[keep], zetas[keep]
    if not len(poles):
        return []
    shapes = residues_at(record, poles, differentiations).reshape(len(poles), -1).T
    result = []
    earlier = np.array([pole.natural_frequency for pole in before])
    others = np.array([pole.shape for pole in before]).T if before else np.zeros((len(shapes), 0))
    likeness = modal_assurance(shapes, others) if before else np.zeros((len(poles), 0))
    for k, (omega, zeta) in enumerate(zip(omegas, zetas, strict=True)):
        stability = NEW
        near = np.flatnonzero(np.abs(earlier - omega) <= rules.frequency * omega)
        if len(near):
            # Of several at the same frequency the one of the likest shape.
            best = int(near[np.argmax(likeness[k, near])])
            is_damped = abs(before[best].damping_ratio - zeta) <= rules.damping * zeta
            is_alike = bool(likeness[k, best] >= rules.shape)
            stability = STABLE if is_damped and is_alike else DAMPING if is_damped else FREQUENCY
        result.append(ChartPole(found.order, float(omega), float(zeta), shapes[:, k], stability))
    return result


def _modes(
    poles: tuple[ChartPole, ...], max_order: int, rules: StabilityCriteria
) -> tuple[FloatArray, FloatArray, IndexArray]:
    """Gather stable poles from the highest order down; each joins the mode of like frequency and shape."""
    groups: list[list[ChartPole]] = []
    for pole in sorted((p for p in poles if p.stability == STABLE), key=lambda p: -p.order):
        best, likest = None, rules.shape
        for group in groups:
            last = group[-1]
            if (
                abs(last.natural_frequency - pole.natural_frequency)
                > rules.frequency * pole.natural_frequency
            ):
                continue
            if last.order == pole.order:
                continue
            likeness = float(modal_assurance(last.shape, pole.shape)[0, 0])
            if likeness >= likest:
                best, likest = group, likeness
        if best is None:
            groups.append([pole])
        else:
            best.append(pole)
    chosen = []
    for group in groups:
        span = max_order - group[-1].order + 1
        if len(group) >= max(3, rules.share * span, 0.25 * max_order):
            omega = float(np.median([p.natural_frequency for p in group]))
            zeta = float(np.median([p.damping_ratio for p in group]))
            chosen.append((omega, zeta, len(group)))
    chosen.sort()
    return (
        np.array([c[0] for c in chosen]),
        np.array([c[1] for c in chosen]),
        np.array([c[2] for c in chosen], dtype=np.intp),
    )
