"""What a beam rig is made of, as frozen and validated dataclasses in SI units.

Every check of the package's input stands here: the other modules trust what they are given.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal, get_args

from beam_model.errors import BeamParameterError

Gravity = Literal["off", "upright", "hanging"]
BendingTheory = Literal["euler-bernoulli", "timoshenko"]

STANDARD_GRAVITY = 9.80665
"""Acceleration of free fall [m/s^2] (CGPM 1901)."""

_GAS_CONSTANT = 287.053  # J/(kg K), of dry air


def check_number(
    name: str,
    value: object,
    unit: str,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    allow_infinite: bool = False,
    remedy: str = "",
) -> float:
    """Return ``value`` as a float, or say which range it has left.

    Raises
    ------
    BeamParameterError
        If ``value`` is not a number, is NaN, is infinite without leave, or lies outside of the range.
    """
    bounds = []
    if above is not None:
        bounds.append(f"above {above:g}")
    if at_least is not None:
        bounds.append(f"at least {at_least:g}")
    if at_most is not None:
        bounds.append(f"at most {at_most:g}")
    kind = "a number" if allow_infinite else "a finite number"
    expected = " ".join([kind, " and ".join(bounds), unit if bounds else f"in {unit}" if unit else ""])
    expected = " ".join(expected.split())
    if isinstance(value, (bool, str, bytes)) or value is None:
        raise BeamParameterError(name, value, unit, expected, remedy)
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError) as err:
        raise BeamParameterError(name, value, unit, expected, remedy) from err
    is_bad = (
        math.isnan(number)
        or (math.isinf(number) and not allow_infinite)
        or (above is not None and not number > above)
        or (at_least is not None and not number >= at_least)
        or (at_most is not None and not number <= at_most)
    )
    if is_bad:
        raise BeamParameterError(name, number, unit, expected, remedy)
    return number


@dataclass(frozen=True)
class PointMass:
    """A small body fixed to the beam: a marker, an accelerometer.

    Parameters
    ----------
    height : float
        Distance from the clamp [m].
    mass : float
        Mass [kg]; zero is allowed, so that a marker's weight may be ignored.
    """

    height: float
    mass: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "height", check_number("point_mass.height", self.height, "m", above=0.0))
        object.__setattr__(self, "mass", check_number("point_mass.mass", self.mass, "kg", at_least=0.0))


@dataclass(frozen=True)
class Damping:
    """How the beam loses energy; the parts add up.

    Parameters
    ----------
    ratios : tuple of float
        Damping ratios of the clamped modes, first mode first; the last one holds for all modes above.
    viscous : float
        xi [N s/m^2], distributed damping of the motion relative to the hub (thesis eq. (2.39)).
    air : float
        xi_a [N s/m^2], distributed damping of the absolute motion: it also acts on the hub.
    internal : float
        eta [s], Kelvin-Voigt damping of the material: stress = E (strain + eta d strain/dt).
    """

    ratios: tuple[float, ...] = ()
    viscous: float = 0.0
    air: float = 0.0
    internal: float = 0.0

    def __post_init__(self) -> None:
        ratios: Iterable[object] = self.ratios if isinstance(self.ratios, Iterable) else (self.ratios,)
        checked = tuple(
            check_number(
                f"damping.ratios[{index}]",
                ratio,
                "",
                at_least=0.0,
                at_most=0.99,
                remedy="Damping ratios are fractions of critical damping: 0.005, not 0.5 %.",
            )
            for index, ratio in enumerate(ratios)
        )
        object.__setattr__(self, "ratios", checked)
        for name, unit in (("viscous", "N s/m^2"), ("air", "N s/m^2"), ("internal", "s")):
            value = check_number(f"damping.{name}", getattr(self, name), unit, at_least=0.0)
            object.__setattr__(self, name, value)

    def modal_ratio(self, mode: int) -> float:
        """Return the prescribed ratio of the clamped mode with this index, counted from 0."""
        if not self.ratios:
            return 0.0
        return self.ratios[min(mode, len(self.ratios) - 1)]


@dataclass(frozen=True)
class Section:
    """The strip's rectangular section, for what bending alone does not show: its rotation, its shear, its air.

    Parameters
    ----------
    width : float
        b, across the motion [m].
    thickness : float
        h, in the direction of motion [m].
    poissons_ratio : float
        nu of the material.
    shear_coefficient : float
        k, the section's mean shear strain over that at its centre; 0: k = 10 (1 + nu)/(12 + 11 nu) of a rectangle
        (Cowper 1966).
    """

    width: float
    thickness: float
    poissons_ratio: float = 0.3
    shear_coefficient: float = 0.0

    def __post_init__(self) -> None:
        for name in ("width", "thickness"):
            value = check_number(f"section.{name}", getattr(self, name), "m", above=0.0)
            object.__setattr__(self, name, value)
        ratio = check_number("section.poissons_ratio", self.poissons_ratio, "", above=-1.0, at_most=0.5)
        coefficient = check_number(
            "section.shear_coefficient", self.shear_coefficient, "", at_least=0.0, at_most=1.0
        )
        if coefficient == 0.0:
            coefficient = 10.0 * (1.0 + ratio) / (12.0 + 11.0 * ratio)
        object.__setattr__(self, "poissons_ratio", ratio)
        object.__setattr__(self, "shear_coefficient", coefficient)

    @property
    def gyration_radius(self) -> float:
        """sqrt(I/A) [m]."""
        return self.thickness / math.sqrt(12.0)

    @property
    def shear_ratio(self) -> float:
        """E/(k G), with E/G = 2 (1 + nu)."""
        return 2.0 * (1.0 + self.poissons_ratio) / self.shear_coefficient


@dataclass(frozen=True)
class StillAir:
    """Dry air at rest, which moves along with the strip and resists it by its viscosity.

    Parameters
    ----------
    temperature : float
        [K].
    pressure : float
        [Pa].
    """

    temperature: float = 293.15
    pressure: float = 101325.0

    def __post_init__(self) -> None:
        remedy = "20 degrees Celsius are 293.15 K."
        value = check_number(
            "air.temperature", self.temperature, "K", at_least=100.0, at_most=2000.0, remedy=remedy
        )
        object.__setattr__(self, "temperature", value)
        object.__setattr__(self, "pressure", check_number("air.pressure", self.pressure, "Pa", above=0.0))

    @property
    def density(self) -> float:
        """rho_a = p/(R T) [kg/m^3]."""
        return self.pressure / (_GAS_CONSTANT * self.temperature)

    @property
    def viscosity(self) -> float:
        """Dynamic viscosity mu = 1.458e-6 T^(3/2)/(T + 110.4) [Pa s], Sutherland (US Standard Atmosphere 1976)."""
        return 1.458e-6 * self.temperature * math.sqrt(self.temperature) / (self.temperature + 110.4)


@dataclass(frozen=True)
class BeamParameters:
    """A uniform beam on a hub that travels across it.

    Parameters
    ----------
    length : float
        L, from clamp to tip [m].
    flexural_rigidity : float
        EI [N m^2].
    mass_per_length : float
        rho, as in the thesis [kg/m].
    hub_mass : float
        m, everything that travels but the beam [kg].
    tip_mass : float
        M_t [kg].
    tip_inertia : float
        J_t, rotary inertia of the tip mass about the tip [kg m^2].
    gravity : {"off", "upright", "hanging"}
        Which way the beam stands in the Earth's field; its own weight then loads it along its axis.
    point_masses : tuple of PointMass
        Markers and other small bodies.
    clamp_stiffness : float
        k_theta, rotational stiffness of the clamp [N m/rad]; inf for a rigid one.
    damping : Damping
        How energy is lost.
    section : Section, optional
        Needed by Timoshenko's theory and by ``air``.
    theory : {"euler-bernoulli", "timoshenko"}
        Whether sections also turn with inertia of their own and shear.
    air : StillAir, optional
        The air around the strip: its added mass and its viscous damping (Sader 1998); None: none of both.

    Raises
    ------
    BeamParameterError
        Naming the parameter, its value, its unit and its range.
    """

    length: float
    flexural_rigidity: float
    mass_per_length: float
    hub_mass: float
    tip_mass: float = 0.0
    tip_inertia: float = 0.0
    gravity: Gravity = "off"
    point_masses: tuple[PointMass, ...] = ()
    clamp_stiffness: float = math.inf
    damping: Damping = field(default_factory=Damping)
    section: Section | None = None
    theory: BendingTheory = "euler-bernoulli"
    air: StillAir | None = None

    def __post_init__(self) -> None:
        for name, unit in (
            ("length", "m"),
            ("flexural_rigidity", "N m^2"),
            ("mass_per_length", "kg/m"),
            ("hub_mass", "kg"),
        ):
            object.__setattr__(self, name, check_number(name, getattr(self, name), unit, above=0.0))
        for name, unit in (("tip_mass", "kg"), ("tip_inertia", "kg m^2")):
            object.__setattr__(self, name, check_number(name, getattr(self, name), unit, at_least=0.0))
        stiffness = check_number(
            "clamp_stiffness",
            self.clamp_stiffness,
            "N m/rad",
            above=0.0,
            allow_infinite=True,
            remedy="A rigid clamp is inf.",
        )
        object.__setattr__(self, "clamp_stiffness", stiffness)
        if self.gravity not in get_args(Gravity):
            raise BeamParameterError(
                "gravity",
                self.gravity,
                "",
                '"off", "upright" or "hanging"',
                "In YAML, off must stand in quotes: an unquoted off is a boolean.",
            )
        masses = tuple(self.point_masses)
        for index, mass in enumerate(masses):
            if not isinstance(mass, PointMass):
                raise BeamParameterError(f"point_masses[{index}]", mass, "", "a PointMass(height, mass)")
            if mass.height > self.length:
                raise BeamParameterError(
                    f"point_masses[{index}].height",
                    mass.height,
                    "m",
                    f"above 0 and at most the beam's length of {self.length:g} m",
                    "Measure heights from the clamp.",
                )
        object.__setattr__(self, "point_masses", masses)
        if not isinstance(self.damping, Damping):
            raise BeamParameterError("damping", self.damping, "", "a Damping(ratios, viscous, air, internal)")
        self._check_section()

    def _check_section(self) -> None:
        if self.theory not in get_args(BendingTheory):
            raise BeamParameterError("theory", self.theory, "", '"euler-bernoulli" or "timoshenko"')
        for name, kind in (("section", Section), ("air", StillAir)):
            value = getattr(self, name)
            if value is not None and not isinstance(value, kind):
                raise BeamParameterError(name, value, "", f"None or a {kind.__name__}")
        if self.section is None and (self.theory == "timoshenko" or self.air is not None):
            raise BeamParameterError(
                "section",
                None,
                "",
                "a Section(width, thickness) for Timoshenko's theory and for the air around the strip",
                "Give it, or make the parameters by BeamParameters.from_section.",
            )

    @classmethod
    def from_section(
        cls,
        length: float,
        width: float,
        thickness: float,
        density: float,
        youngs_modulus: float,
        *,
        hub_mass: float,
        tip_mass: float = 0.0,
        tip_inertia: float = 0.0,
        gravity: Gravity = "off",
        point_masses: tuple[PointMass, ...] = (),
        clamp_stiffness: float = math.inf,
        damping: Damping | None = None,
        theory: BendingTheory = "euler-bernoulli",
        poissons_ratio: float = 0.3,
        shear_coefficient: float = 0.0,
        air: StillAir | None = None,
    ) -> BeamParameters:
        """Return the parameters of a strip with a rectangular section.

        Parameters
        ----------
        length, width, thickness : float
            Of the strip [m]; ``thickness`` is in the direction of motion.
        density : float
            Of the material [kg/m^3].
        youngs_modulus : float
            E [Pa]; not E/(1 - nu^2): a strip this slender is a beam, not a plate.
        hub_mass, tip_mass, tip_inertia, gravity, point_masses, clamp_stiffness, damping, theory, air
            As in ``BeamParameters``.
        poissons_ratio, shear_coefficient : float
            As in ``Section``.

        Notes
        -----
        EI = E b h^3 / 12, rho = density b h.
        """
        width = check_number("width", width, "m", above=0.0)
        thickness = check_number("thickness", thickness, "m", above=0.0)
        density = check_number("density", density, "kg/m^3", above=0.0)
        youngs_modulus = check_number("youngs_modulus", youngs_modulus, "Pa", above=0.0)
        return cls(
            length=length,
            flexural_rigidity=youngs_modulus * width * thickness**3 / 12.0,
            mass_per_length=density * width * thickness,
            hub_mass=hub_mass,
            tip_mass=tip_mass,
            tip_inertia=tip_inertia,
            gravity=gravity,
            point_masses=point_masses,
            clamp_stiffness=clamp_stiffness,
            damping=Damping() if damping is None else damping,
            section=Section(width, thickness, poissons_ratio, shear_coefficient),
            theory=theory,
            air=air,
        )

    @property
    def beam_mass(self) -> float:
        """Everything that bends [kg]: strip, point masses and tip mass."""
        strip = self.mass_per_length * self.length
        return strip + self.tip_mass + sum(mass.mass for mass in self.point_masses)

    @property
    def total_mass(self) -> float:
        """Hub and beam together [kg]: J of thesis eq. (2.36), with the tip mass and the markers."""
        return self.hub_mass + self.beam_mass

    @property
    def gravity_sign(self) -> int:
        """The sign s in the potential energy V: +1 upright, -1 hanging, 0 without gravity."""
        return {"off": 0, "upright": 1, "hanging": -1}[self.gravity]

    @property
    def time_scale(self) -> float:
        """sqrt(rho L^4 / EI) [s]: omega times this is the square of a dimensionless root."""
        return math.sqrt(self.mass_per_length * self.length**4 / self.flexural_rigidity)

    @property
    def tip_mass_ratio(self) -> float:
        """M_t / (rho L)."""
        return self.tip_mass / (self.mass_per_length * self.length)

    @property
    def tip_inertia_ratio(self) -> float:
        """J_t / (rho L^3)."""
        return self.tip_inertia / (self.mass_per_length * self.length**3)

    @property
    def clamp_compliance(self) -> float:
        """EI / (k_theta L): 0 for a rigid clamp."""
        return self.flexural_rigidity / (self.clamp_stiffness * self.length)

    @property
    def rotary_inertia_ratio(self) -> float:
        """I/(A L^2): the inertia with which sections turn, over rho L^2; 0 in Euler and Bernoulli's theory."""
        if self.theory == "euler-bernoulli" or self.section is None:
            return 0.0
        return (self.section.gyration_radius / self.length) ** 2

    @property
    def shear_compliance(self) -> float:
        """EI/(k G A L^2): how much a section shears, against how much it bends; 0 in Euler and Bernoulli's theory."""
        return 0.0 if self.section is None else self.rotary_inertia_ratio * self.section.shear_ratio

    @property
    def weight_ratio(self) -> float:
        """Weight against stiffness, rho g L^3 / EI: an upright strip without a tip mass buckles at 7.84."""
        return self.mass_per_length * STANDARD_GRAVITY * self.length**3 / self.flexural_rigidity

    def check_heights(self, heights: object, name: str = "heights") -> tuple[float, ...]:
        """Return ``heights`` as floats between clamp and tip [m].

        Raises
        ------
        BeamParameterError
            If one of them is not a number or lies off the beam.
        """
        values = tuple(heights) if isinstance(heights, Iterable) else (heights,)
        # A height computed as 0.1 + 0.2 may lie one rounding above a length of 0.3.
        limit = self.length * (1.0 + 1e-12)
        return tuple(
            min(
                check_number(
                    f"{name}[{index}]",
                    value,
                    "m",
                    at_least=0.0,
                    at_most=limit,
                    remedy=f"Heights run from the clamp (0) to the tip ({self.length:g} m).",
                ),
                self.length,
            )
            for index, value in enumerate(values)
        )
