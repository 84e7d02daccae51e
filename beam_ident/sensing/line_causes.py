"""What the residuals of a fit to frequency data look like: an output that is late, or coupled through a high-pass.

A sensor passes ``e^(-s T)``, which is ``1 - s T`` where T is short, or ``1 / (1 + s T)``, ``1 - s T + (s T)^2``, or
``s / (s + w)``, which is ``1 - w / s`` above its corner. So such a sensor leaves the modelled response times ``s``,
its square or its inverse, with a real factor. Frequencies, damping and numerators can make up for a part of that, and
are biased then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.noise.line_weights import line_weights, stacked_values
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.sensing.misfit_causes import slow_answer

_LEVEL = 30.0  # of a chi-squared of one degree of freedom: by chance once in 20 million looks
_NOTHING_NEW = 1e-12  # of the square of a column: rounding
_MOST = 0.5  # of what is left beyond noise: a cause that explains less is not the one


@dataclass(frozen=True, eq=False)
class FittedLines:
    """What a fit to frequency data leaves of one output.

    Attributes
    ----------
    name : str
    s : ndarray of complex, shape (n_lines,) -- [rad/s]
    modelled : ndarray of complex, shape (n_lines,)
    weights, residuals : ndarray, shape (2 n_lines,) -- of real parts and then imaginary ones; residuals are weighed
    design : ndarray, shape (2 n_lines, n_parameters) -- derivatives of the model, weighed
    """

    name: str
    s: ComplexArray
    modelled: ComplexArray
    weights: FloatArray
    residuals: FloatArray
    design: FloatArray

    @staticmethod
    def of(
        record: FrequencyRecord,
        modelled: FloatArray,
        residuals: Sequence[FloatArray],
        designs: Sequence[FloatArray],
    ) -> list[FittedLines]:
        """Return the lines of every output under each input of a record.

        Parameters
        ----------
        record : FrequencyRecord
        modelled : ndarray, shape (2 n_lines, n_outputs * n_inputs) -- real parts, and then imaginary ones
        residuals, designs : sequence of ndarray -- of every such pair
        """
        n, found = record.n_lines, []
        for pair, (left, design) in enumerate(zip(residuals, designs, strict=True)):
            j, i = divmod(pair, record.n_inputs)
            lines = modelled[:n, pair] + 1j * modelled[n:, pair]
            weights = line_weights(record, j, i)
            found.append(FittedLines(record.output_names[j], record.s, lines, weights, left, design))
        return found


def line_causes(outputs: Sequence[FittedLines], is_noise_known: bool) -> list[str]:
    """Return what the residuals of outputs look like, one sentence for each that looks like more than noise.

    Parameters
    ----------
    outputs : sequence of FittedLines
    is_noise_known : bool -- residuals that are noise have a variance of 1
    """
    said = []
    for own in outputs:
        fitted = LinearSolution.of(own.design)
        power = float(own.residuals @ own.residuals)
        freedom = int(np.count_nonzero(own.weights)) - len(fitted.kept) - 1
        if freedom < 1:
            continue
        found = []
        for looks, column in (
            (_late, -own.s * own.modelled),
            (_passed, own.s**2 * own.modelled),
            (slow_answer, own.modelled / (own.s / (2.0 * math.pi))),
        ):
            rows = own.weights * stacked_values(column)
            free = fitted.left_of(rows)
            size = float(free @ free)
            if not size > _NOTHING_NEW * float(rows @ rows):  # the fit has a parameter for it
                continue
            factor = float(free @ own.residuals) / size
            left = own.residuals - factor * free
            noise = float(left @ left) / freedom
            # Few lines may carry the column, and be louder than the others.
            spread = max(size * (max(noise, 1.0) if is_noise_known else noise), float(free**2 @ left**2))
            found.append((factor**2 * size, looks(factor), (factor * size) ** 2 > _LEVEL * spread))
        excess = power - freedom if is_noise_known else 0.0
        gain, words, is_seen = max(found, default=(0.0, "", False))
        if is_seen and gain > _MOST * excess:
            said.append(f"Misfit of {own.name}: the residuals look {words}. If that is so, poles are biased.")
    return said


def _late(delay_s: float) -> str:
    return (
        f"as if it were seen {1e3 * delay_s:.3g} ms late (a delay, a low-pass, a hold that is not as stated)"
    )


def _passed(square_s2: float) -> str:
    size = f"{1e3 * math.sqrt(abs(square_s2)):.2g} ms in the square"
    if square_s2 > 0.0:
        return f"as if it were seen through a low-pass or an exposure that is not stated, of {size}"
    return f"as if it had passed less of a low-pass, an exposure or a hold than is stated, by {size}"
