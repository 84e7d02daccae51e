"""A modal model in other forms: polynomials, states, and its step response.

With ``d_i = s^2 + 2 zeta_i omega_i s + omega_i^2``, D the product of all, e the differentiations of
the structure and k = 2 - e the integrations of its direct part (0 where it has none), output j is

    [ c_j D s^(e-2+k) + sign s^(e+k) (sum_i r_ij D/d_i + R_j D) ] / (s^k D)

States stay modal, two for each mode, so that they keep their digits at any order.
"""

from __future__ import annotations

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.errors import EstimationError
from beam_ident.modal.structure import ModalStructure


def n_integrations(structure: ModalStructure) -> int:
    """Return how many poles at zero the direct part has."""
    return 2 - structure.differentiations if structure.has_direct else 0


def transfer_polynomials(
    structure: ModalStructure,
    omegas: FloatArray,
    zetas: FloatArray,
    gains: FloatArray,
    residues: FloatArray,
    residual_terms: FloatArray,
) -> tuple[list[FloatArray], FloatArray]:
    """Return the numerator of every output and their common denominator, descending powers of s."""
    sections = [np.array([1.0, 2.0 * z * w, w * w]) for w, z in zip(omegas, zetas, strict=True)]
    product = np.ones(1)
    for section in sections:
        product = np.polymul(product, section)
    k = n_integrations(structure)
    numerators = []
    for gain, own, residual in zip(gains, residues, residual_terms, strict=True):
        modal = residual * product
        for i, residue in enumerate(own):
            others = np.ones(1)
            for j, section in enumerate(sections):
                if j != i:
                    others = np.polymul(others, section)
            modal = np.polyadd(modal, residue * others)
        total = structure.sign * np.concatenate([modal, np.zeros(structure.differentiations + k)])
        if structure.has_direct:
            rigid = np.concatenate([gain * product, np.zeros(structure.differentiations - 2 + k)])
            total = np.polyadd(total, rigid)
        numerators.append(np.trim_zeros(total, "f") if np.any(total) else np.zeros(1))
    return numerators, np.concatenate([product, np.zeros(k)])


def modal_state_space(
    structure: ModalStructure,
    omegas: FloatArray,
    zetas: FloatArray,
    gains: FloatArray,
    residues: FloatArray,
    residual_terms: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return A, B, C, D with the states ``omega_i q_i, q_i'`` of every mode, then the integrators.

    Raises
    ------
    EstimationError
        A residual term under an input that would have to be differentiated.
    """
    e, k = structure.differentiations, n_integrations(structure)
    if e > 0 and np.any(residual_terms != 0.0):
        way = (
            'take driven_by("acceleration").state_space(), the same model from the acceleration'
            if structure.is_motion
            else "estimate it with ModalStructure(.., has_residual=False)"
        )
        raise EstimationError(
            f"the residual terms differentiate the input of a {structure.kind!r} model, which no state space "
            f"can; {way}"
        )
    n, m = len(omegas), len(gains)
    transition = np.zeros((2 * n + k, 2 * n + k))
    entry = np.zeros((2 * n + k, 1))
    rows = np.zeros((m, 2 * n + k))
    through = np.zeros((m, 1))
    for i, (w, z) in enumerate(zip(omegas, zetas, strict=True)):
        at = 2 * i
        transition[at : at + 2, at : at + 2] = [[0.0, w], [-w, -2.0 * z * w]]
        entry[at + 1, 0] = 1.0
        own = structure.sign * residues[:, i]
        if e == 0:
            rows[:, at] = own / w
        elif e == 1:
            rows[:, at + 1] = own
        else:
            rows[:, at], rows[:, at + 1] = -own * w, -2.0 * z * w * own
            through[:, 0] += own
    if e == 0:
        through[:, 0] += structure.sign * residual_terms
    if structure.has_direct:
        if k == 0:
            through[:, 0] += gains
        else:
            for j in range(k - 1):  # the last integrator feeds the one before it
                transition[2 * n + j, 2 * n + j + 1] = 1.0
            entry[-1, 0] = 1.0
            rows[:, 2 * n] = gains
    return transition, entry, rows, through


def modal_step_response(
    structure: ModalStructure,
    omegas: FloatArray,
    zetas: FloatArray,
    gains: FloatArray,
    residues: FloatArray,
    residual_terms: FloatArray,
    times: FloatArray,
) -> FloatArray:
    """Return the response to a unit step at 0 s for times after it, shape (n_times, n_outputs).

    Notes
    -----
    Under a displacement or velocity the residual term answers with an impulse at 0 s, which is left out.
    """
    e = structure.differentiations
    poles = (omegas * (-zetas + 1j * np.sqrt(1.0 - zetas**2))).astype(np.complex128)
    motion = np.exp(times[:, None] * poles) / (2j * poles.imag)
    modal: FloatArray = 2.0 * np.real(motion * poles ** (e - 1))
    if e == 0:
        modal = modal + 1.0 / omegas**2
    result = structure.sign * (modal @ residues.T)
    if e == 0:
        result += structure.sign * residual_terms
    if structure.has_direct:
        drift = times ** (2 - e) / (2.0 if e == 0 else 1.0)
        result += drift[:, None] * gains
    return np.asarray(result)
