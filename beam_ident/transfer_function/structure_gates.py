"""Why the structure of a transfer function, or all of it, is not to be believed.

A fit of noise converges too: what it converged to must explain the data better than noise of any colour does,
every pole must be known well enough to mean something, and no pole may be cancelled by a zero
within their uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.noise.outliers import outlier_warning
from beam_ident.noise.record_fit import RecordFit
from beam_ident.noise.scores import Whiteness, is_coloured
from beam_ident.sensing.misfit_causes import misfit_warnings
from beam_ident.sensing.quantisation import rounding_warning
from beam_ident.transfer_function.model import TransferFunctionModel

UNRELATED = (
    "The model explains no more than chance would: BIC prefers noise without an input. Is it the right input, on the "
    "same clock?"
)

_MAX_POLE_SD = 0.5  # of the pole's modulus
_CANCELLATION = 3.0  # standard deviations between a pole and the nearest zero


def information_criterion(residuals: Sequence[FloatArray], n_parameters: int) -> float:
    """Return BIC of every record's residuals as they are, with their variances unknown, up to a constant.

    Notes
    -----
    The constant is that of a common variance ``n log RSS``: with one record it is nothing else.
    """
    n = sum(len(own) for own in residuals)
    misfit = sum(len(own) * math.log(n / len(own) * max(float(own @ own), 1e-300)) for own in residuals)
    return misfit + n_parameters * math.log(n)


def transfer_function_warnings(
    models: Sequence[TransferFunctionModel],
    records: Sequence[RecordFit],
    whiteness: Whiteness,
    is_worth_it: bool,
    converged: bool,
    reason: str,
) -> tuple[str, ...]:
    """Return what a reader must know before trusting the numbers of transfer functions to one output.

    Parameters
    ----------
    models : sequence of TransferFunctionModel -- one for each input
    records : sequence of RecordFit -- of the output
    whiteness : Whiteness -- of the residuals, or of the innovations under the noise's model
    is_worth_it : bool -- whether they explain more than noise of any colour would (``noise.relation``)
    converged, reason
        How the fit ended.
    """
    warnings = [] if converged else [f"The fit did not converge: {reason}."]
    if not is_worth_it:
        warnings.append(UNRELATED)
    for model in models:
        complaint = structure_complaint(model) or _damping_complaint(model)
        if complaint:
            said = f"From {model.input_name} to {model.output_name}, {complaint}."
            warnings += [said] if said not in warnings else []
    if said := outlier_warning([(models[0].output_name, records)]):
        warnings.append(said)
    if said := rounding_warning([(models[0].output_name, records)]):
        warnings.append(said)
    warnings += misfit_warnings(
        [(models[0].output_name, [(own.times_s, own.modelled, own.residuals) for own in records])]
    )
    white = ("Student", "white noise")
    weighed = [own.noise for own in records if own.noise and not own.noise.startswith(white)]
    if weighed:
        warnings.append(
            f"The residuals of {models[0].output_name} are not white; the fit is weighed by their noise, taken for "
            f"{'; '.join(dict.fromkeys(weighed))}. If it is unmodelled dynamics, a bias remains."
        )
    elif any(is_coloured(whiteness, own.measured, own.residuals) for own in records):
        warnings.append(
            f"The residuals of {models[0].output_name} are not white: something is left unmodelled, the noise is "
            "coloured, or the input as it was measured is itself noisy. The standard deviations count the colour, "
            "but no bias. Try other degrees."
        )
    return tuple(warnings)


def _damping_complaint(model: TransferFunctionModel) -> str:
    """Return which mode is not known to be damped at all, or an empty string."""
    for omega, zeta, sd in zip(*(model.modes()[k] for k in (0, 1, 3)), strict=True):
        if not sd < zeta:
            return f"the damping ratio at {omega:.4g} rad/s is {zeta:.2g} +- {sd:.2g}"
    return ""


def structure_complaint(model: TransferFunctionModel) -> str:
    """Return why the degrees of a model are not to be trusted, or an empty string.

    Poles at zero are known integrators and not judged.
    """
    poles = model.poles
    poles = poles[(poles.imag >= 0.0) & (poles != 0.0)]
    n = model.n_poles
    by_a = model.pole_sensitivities(poles)
    size = np.einsum("ka,ab,kb->k", by_a, model.covariance[:n, :n], np.conj(by_a)).real
    for pole, variance in zip(poles, size, strict=True):
        if not math.sqrt(max(variance, 0.0)) < _MAX_POLE_SD * abs(pole):
            share = math.sqrt(max(variance, 0.0)) / abs(pole)
            return f"the pole at {abs(pole):.4g} rad/s is known to {share:.0%} only"
    zeros = model.zeros
    if not len(zeros):
        return ""
    m = len(model.numerator) - 1
    slope = np.polyval(np.polyder(model.numerator), zeros)
    by_b = -(zeros[:, None] ** np.arange(m, -1, -1)) / slope[:, None]
    for k, pole in enumerate(poles):
        nearest = int(np.argmin(np.abs(zeros - pole)))
        gradient = np.concatenate([by_a[k], -by_b[nearest], [0.0]])
        parts = np.stack([gradient.real, gradient.imag])
        covariance = parts @ model.covariance @ parts.T
        apart = np.array([(pole - zeros[nearest]).real, (pole - zeros[nearest]).imag])
        if pole.imag == 0.0:
            covariance, apart = covariance[:1, :1], apart[:1]
        distance = float(apart @ np.linalg.pinv(covariance, rcond=1e-12, hermitian=True) @ apart)
        if distance < _CANCELLATION**2:
            return f"a zero cancels the pole at {abs(pole):.4g} rad/s within {_CANCELLATION:.0f} standard deviations"
    return ""
