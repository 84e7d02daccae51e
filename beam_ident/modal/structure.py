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

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from beam_ident.errors import EstimationError
from beam_ident.modal.mode_change import ModeChange

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

_MOTIONS = (
    ("m", "mm", "um", "rad", "deg"),
    ("m/s", "mm/s", "rad/s", "deg/s"),
    ("m/s^2", "mm/s^2", "g", "rad/s^2"),
)
"""Units of a displacement, and of what it is differentiated once and twice."""
_FORCES = ("N", "mN", "kN", "N m", "A", "mA", "V", "mV", "kV", "Pa", "kPa", "bar")
"""Units of a force, and of what actuators make forces of."""
_SPELLINGS = {
    "m/s2": "m/s^2",
    "m/s²": "m/s^2",
    "m/s/s": "m/s^2",
    "µm": "um",
    "μm": "um",
    "Nm": "N m",
    "N*m": "N m",
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
    changes : tuple of ModeChange
        Modes whose natural frequencies change while they are recorded.
    """

    kind: StructureKind = "base_motion"
    has_residual: bool = True
    has_offset: bool = True
    has_ramp: bool = True
    has_free_response: bool = True
    changes: tuple[ModeChange, ...] = ()

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
    def driving_power(self) -> int:
        """Power of s by which the input becomes what drives the modes: an acceleration of the base, or a force."""
        return self.differentiations if self.is_motion else 0

    @property
    def is_test(self) -> bool:
        """Whether force and motion are what a vibration test measures, by one instrument with one clock."""
        return self.kind in ("receptance", "mobility", "accelerance")

    @property
    def pace_powers(self) -> tuple[int, int]:
        """Powers of the pace of a mode that changes, by which its input and its motion are multiplied."""
        if self.is_motion:
            return self.differentiations - 2, 0
        return -2, self.differentiations

    @property
    def has_direct(self) -> bool:
        """Whether the outputs follow a rigid body, with gains c_j."""
        return self.kind != "receptance"

    def direct_response(self, s: complex) -> complex:
        """Return the factor of c_j at the complex frequency ``s``."""
        if not self.has_direct:
            return 0.0
        return s ** (self.differentiations - 2)


def kinds_by_units(input_units: Iterable[str], output_units: Iterable[str]) -> tuple[StructureKind, ...]:
    """Return the structures that go with the units of inputs and outputs; between several the data decide.

    Parameters
    ----------
    input_units, output_units : iterable of str
        A unit that is not known here is taken for a displacement.

    Raises
    ------
    EstimationError
        Inputs or outputs of different kinds, or outputs that no structure derives from the input.

    Notes
    -----
    The response of a displacement to a displacement is ``s^0 H``; each differentiation of the output, or integration
    of the input, is one ``s`` more.
    """
    inputs, outputs = sorted(set(input_units)), sorted(set(output_units))
    orders = {_differentiated(unit) for unit in outputs}
    are_forces = {_spelt(unit) in _FORCES for unit in inputs}
    integrations = {_differentiated(unit) - order for unit in inputs for order in orders}
    if len(orders) == len(are_forces) == 1:
        if True in are_forces:
            of_tests: tuple[tuple[StructureKind, ...], ...]
            of_tests = ("force", "receptance"), ("mobility",), ("accelerance",)
            return of_tests[orders.pop()]
        moved: tuple[StructureKind, ...] = ("base_motion", "velocity", "acceleration")
        if len(integrations) == 1 and (order := integrations.pop()) >= 0:
            return (moved[order],)
    raise EstimationError(
        f"no structure goes with inputs in {', '.join(map(repr, inputs))} and outputs in "
        f"{', '.join(map(repr, outputs))}: expected inputs of one kind, outputs of one kind, and an input that is a "
        f"force or no smoother than the outputs. Name one of {', '.join(_DIFFERENTIATIONS)}, or make a record for "
        "each kind of sensor"
    )


def _spelt(unit: str) -> str:
    return _SPELLINGS.get(unit.strip(), unit.strip())


def _differentiated(unit: str) -> int:
    """Return how often a displacement is differentiated to have this unit."""
    return next((order for order, units in enumerate(_MOTIONS) if _spelt(unit) in units), 0)
