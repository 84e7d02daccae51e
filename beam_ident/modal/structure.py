"""Which input goes with which modal model.

All structures are sums of second-order modes with poles common to all outputs:

    base_motion    u_j = c_j alpha     - s^2 [ sum_i r_ij / d_i(s) + R_j ] alpha
    velocity       u_j = c_j v / s     - s   [ sum_i r_ij / d_i(s) + R_j ] v
    acceleration   u_j = c_j a / s^2   -     [ sum_i r_ij / d_i(s) + R_j ] a
    force          u_j = c_j f / s^2   +     [ sum_i r_ij / d_i(s) + R_j ] f
    receptance     u_j =                     [ sum_i r_ij / d_i(s) + R_j ] f
    mobility       v_j = c_j f / s   + s     [ sum_i r_ij / d_i(s) + R_j ] f
    accelerance    a_j = c_j f       + s^2   [ sum_i r_ij / d_i(s) + R_j ] f

with ``d_i = s^2 + 2 zeta_i omega_i s + omega_i^2``; each may carry an offset, a ramp and
the free response of its modes.  The first three describe the same beam with the
same parameters: only the quantity in which the motion is known differs.  The last three describe
the same structure under a force, seen by a sensor of displacement, velocity or acceleration; ``c_j`` is
what moves it as a rigid body, or what modes below the band leave of themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from beam_ident.errors import EstimationError

StructureKind = Literal[
    "base_motion", "velocity", "acceleration", "force", "receptance", "mobility", "accelerance"
]

_DIFFERENTIATIONS: dict[str, int] = {
    "base_motion": 2,
    "velocity": 1,
    "acceleration": 0,
    "force": 0,
    "receptance": 0,
    "mobility": 1,
    "accelerance": 2,
}


@dataclass(frozen=True)
class ModalStructure:
    """Terms of the modal model.

    Parameters
    ----------
    kind : {"base_motion", "velocity", "acceleration", "force", "receptance", "mobility", "accelerance"}
    has_residual : bool
        Whether the static term R_j of the modes left out is estimated.
    has_offset, has_ramp : bool
        Whether every output has an unknown constant and a drift, in each record.
    has_free_response : bool
        Whether the modes may already move when a record begins.
    """

    kind: StructureKind = "base_motion"
    has_residual: bool = True
    has_offset: bool = True
    has_ramp: bool = True
    has_free_response: bool = True

    def __post_init__(self) -> None:
        if self.kind not in _DIFFERENTIATIONS:
            raise EstimationError(
                f"structure is {self.kind!r}; expected one of {', '.join(_DIFFERENTIATIONS)}"
            )

    @property
    def differentiations(self) -> int:
        """Power of s in front of the modal sum."""
        return _DIFFERENTIATIONS[self.kind]

    @property
    def sign(self) -> float:
        """Sign in front of the modal sum: -1 for a moved base, +1 for a force."""
        return -1.0 if self.is_motion else 1.0

    @property
    def is_motion(self) -> bool:
        """Whether the input is the motion of the base (its poles are the clamped ones)."""
        return self.kind in ("base_motion", "velocity", "acceleration")

    @property
    def is_test(self) -> bool:
        """Whether force and motion are what a vibration test measures, by one instrument with one clock."""
        return self.kind in ("receptance", "mobility", "accelerance")

    @property
    def has_direct(self) -> bool:
        """Whether the outputs follow a rigid body, with gains c_j."""
        return self.kind != "receptance"

    def direct_response(self, s: complex) -> complex:
        """Return the factor of c_j at the complex frequency ``s``."""
        if not self.has_direct:
            return 0.0
        return s ** (self.differentiations - 2)
