"""Whether periods that are averaged repeat, as the average and its variance take them to.

A fade of the excitation, or a transient that has not settled, differs from period to period.  The scatter
between periods counts it as noise, so that it does not bias a model much but makes it look far too
uncertain.  Outputs are judged by how far their first period stands from their last; inputs, which
have little noise, by whether they differ at one place of the period more than elsewhere.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc as f_sf

from beam_ident.arrays import BoolArray, ComplexArray, FloatArray

_UNSTEADY = 1e-4  # chance that noise alone changes steady periods as much
_MUCH = 2.0  # times the power that noise explains: below this deviations grow little
_BLOCKS = 16  # of a period, in each of which the input's periods are compared
_UNLIKE = 10.0  # times the power of the usual block: what noise does not differ by
_HARMLESS = 1e-6  # of the signal's power, for an input; of its amplitude, for an output


def drift_of_periods(spectra: ComplexArray) -> tuple[FloatArray, BoolArray]:
    """Return how far the first period stands from the last, and whether noise fails to explain it.

    Parameters
    ----------
    spectra : complex ndarray, shape (n_outputs, n_periods, n_bins)

    Returns
    -------
    drift : ndarray, shape (n_outputs,)
        Power of the change over what the scatter of the other periods explains; NaN for fewer than four.
    is_unsteady : ndarray of bool, shape (n_outputs,)

    Notes
    -----
    Under noise alone the drift follows an F distribution.  Coloured noise has as many degrees of freedom
    as lines that carry its power, ``(sum p)^2 / sum p^2``.
    """
    n_outputs, n_periods = spectra.shape[:2]
    if n_periods < 4:
        return np.full(n_outputs, np.nan), np.zeros(n_outputs, dtype=bool)
    change = _power(spectra[:, -1] - spectra[:, 0]) / 2.0
    middle = spectra[:, 1:-1]
    by_line = np.sum(np.abs(middle - np.mean(middle, axis=1)[:, None]) ** 2, axis=1) / (n_periods - 3)
    scatter = np.maximum(np.sum(by_line, axis=1), 1e-300)
    drift = np.asarray(change / scatter)
    freedom = _freedom(by_line)
    is_unexplained = (drift > _MUCH) & (f_sf(freedom, (n_periods - 3) * freedom, drift) < _UNSTEADY)
    # A slow decay scatters the middle too: the change over the first two periods against that over the last.
    pairs = np.abs(np.stack([spectra[:, 1] - spectra[:, 0], spectra[:, -1] - spectra[:, -2]])) ** 2 / 2.0
    sizes = np.sum(pairs, axis=2)
    quieter = np.take_along_axis(pairs, np.argmin(sizes, axis=0)[None, :, None], axis=0)[0]
    ratio = np.max(sizes, axis=0) / np.maximum(np.min(sizes, axis=0), 1e-300)
    freedom = _freedom(quieter)
    is_unexplained |= (ratio > _MUCH) & (2.0 * f_sf(freedom, freedom, ratio) < _UNSTEADY)
    harmless = _HARMLESS**2 * _power(np.mean(spectra, axis=1))
    return drift, np.asarray(is_unexplained & (np.max(sizes, axis=0) > harmless))


def _power(spectra: ComplexArray) -> FloatArray:
    return np.asarray(np.sum(np.abs(spectra) ** 2, axis=1))


def _freedom(by_line: FloatArray) -> FloatArray:
    """Return the degrees of freedom of the sum over lines, shape (n_outputs,)."""
    total = np.sum(by_line, axis=1)
    return np.asarray(2.0 * total**2 / np.maximum(np.sum(by_line**2, axis=1), 1e-300))


def input_changes(ticks: FloatArray) -> bool:
    """Return whether an input's periods differ at one place, as in a fade; noise differs everywhere.

    Parameters
    ----------
    ticks : ndarray, shape (n_periods, n) -- the input, period by period
    """
    own = ticks - np.mean(ticks, axis=1)[:, None]
    usual = np.median(own, axis=0) if len(own) > 2 else np.mean(own, axis=0)
    blocks = np.array_split((own - usual) ** 2, min(_BLOCKS, own.shape[1]), axis=1)
    powers = np.array([np.mean(block, axis=1) for block in blocks])
    floor = max(_UNLIKE * float(np.median(powers)), _HARMLESS * float(np.mean(own**2)))
    return bool(np.max(powers) > floor)


def unsteady_warnings(name: str, has_input_changed: bool, drifts: FloatArray) -> tuple[str, ...]:
    """Return what fits to the mean of periods must pass on, or nothing.

    Parameters
    ----------
    name : str -- of the record
    has_input_changed : bool
    drifts : ndarray -- of the outputs that are not steady
    """
    if not has_input_changed and not len(drifts):
        return ()
    found = "the input is not the same in every period" if has_input_changed else "the periods still change"
    if len(drifts):
        found += f" (drift {np.max(drifts):.3g}; about 1 where they are steady)"
    return (
        f"record {name!r}: {found}, which is counted as noise, so that deviations are too large. Leave out the "
        "fades of the excitation and the time that the structure takes to settle, by start_s and end_s",
    )
