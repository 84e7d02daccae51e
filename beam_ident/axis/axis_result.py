"""What is known of an axis once it is identified, and how it does on records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.stored_form import ADDED_LATER, read, require_shapes, written
from beam_ident.errors import EstimationError
from beam_ident.summary import Summarised, SummaryPart, SummaryTable

SCHEMA = 1

MEANINGS = {
    "mass": "moving mass",
    "force_constant": "force for a unit of the input",
    "viscous": "viscous friction",
    "coulomb": "dry friction",
    "offset": "constant force against +x",
    "coulomb_difference": "dry friction forward less backward",
    "viscous_difference": "viscous friction forward less backward",
    "delay": "delay from force to motion",
    "stiffness": "stiffness of the drive",
    "drive_damping": "damping of the drive's spring",
    "drive_mass": "of the mass, ahead of that spring",
}


@dataclass(frozen=True)
class AxisTerm:
    """A force that the model lacks, as far as a record shows it.

    Attributes
    ----------
    name : str -- on what it depends
    force : float -- its rms over the record, in the unit of the input
    z : float -- its coefficient over the standard deviation
    """

    name: str
    force: float
    z: float


@dataclass(frozen=True)
class AxisCheck:
    """How an identified axis does on records, those of the fit or others.

    Attributes
    ----------
    fit_percent : float
        Of the positions that the force leads to, piece by piece of motion, against those measured.
    residual_sd : float -- measured less simulated [m]
    is_white : bool -- whether that is white noise
    whiteness : str -- the same in words
    terms : tuple of AxisTerm
        Forces that the inverse dynamics of the record show beyond the model, over four standard deviations.
    is_searched : bool -- whether such forces were looked for: behind a compliant drive they are not
    """

    fit_percent: float
    residual_sd: float
    is_white: bool
    whiteness: str
    terms: tuple[AxisTerm, ...]
    is_searched: bool = field(default=True, metadata=ADDED_LATER)

    @property
    def verdict(self) -> str:
        """The same in one sentence."""
        words = (
            f"the simulated positions fit by {self.fit_percent:.3f} %, residuals of {self.residual_sd:.2g} m"
        )
        if not self.is_searched:
            return words
        if self.terms:
            named = ", ".join(f"{term.name} ({term.force:.2g})" for term in self.terms)
            return f"{words}; forces that the model lacks: {named}"
        return f"{words}; no force is seen that the model lacks"


@dataclass(frozen=True, eq=False, repr=False)
class AxisResult(Summarised):
    """Mass and friction of a driven axis.

    Attributes
    ----------
    names : tuple of str -- of the parameters, see ``MEANINGS``
    estimates : ndarray, shape (n,)
    covariance : ndarray, shape (n, n)
    units : tuple of str
    method : str
        Whose estimates these are: "output_error", or "instrumental_variables" where forces that nobody measured
        outweigh the noise of the position.
    other_estimates, other_sd : ndarray, shape (4,)
        The other method's moving mass (or force constant), viscous and dry friction and offset, for comparison.
    force_name, position_name, force_unit : str
    known_mass, known_offset : float -- mass [kg] and constant force [N] that were given; NaN where none was
    modes : tuple of tuple -- natural frequency [rad/s] and damping ratio of every mode that was given
    n_samples : int -- positions in motion, which the estimates rest on
    n_pieces : int -- stretches of motion between rests
    check : AxisCheck -- on the records of the fit
    converged : bool
    reason : str
    iterations : int
    warnings : tuple of str
    encoder : str -- whose position it is, that of the "hub" or of the "drive"
    known_drive_mass : float -- mass ahead of the drive's spring that was given [kg]; NaN where none was
    stiffer_than : float
        What the stiffness of a drive whose spring was looked for and does not show is above, with 95 % [N/m]; NaN
        where none was looked for, where it was found, and where the records cannot tell.

    Notes
    -----
    Forward and backward motion show two sums, F_c+ + F_0 and F_c- - F_0. Without a known constant force F_0 dry
    friction is taken to be equal in both directions, and "offset" is half their difference; with it,
    "coulomb_difference" is F_c+ - F_c-.
    """

    names: tuple[str, ...]
    estimates: FloatArray
    covariance: FloatArray
    units: tuple[str, ...]
    method: str
    other_estimates: FloatArray
    other_sd: FloatArray
    force_name: str
    position_name: str
    force_unit: str
    known_mass: float
    known_offset: float
    modes: tuple[tuple[float, ...], ...]
    n_samples: int
    n_pieces: int
    check: AxisCheck
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]
    encoder: str = field(default="hub", metadata=ADDED_LATER)
    known_drive_mass: float = field(default=float("nan"), metadata=ADDED_LATER)
    stiffer_than: float = field(default=float("nan"), metadata=ADDED_LATER)

    @property
    def standard_deviations(self) -> FloatArray:
        """Of the estimates, shape (n,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def value(self, name: str) -> float:
        """Return an estimate by its name; 0 for a difference or a delay that was not needed.

        Raises
        ------
        EstimationError
            No parameter has this name.
        """
        return self._of(name, self.estimates)

    def sd(self, name: str) -> float:
        """Return the standard deviation of an estimate; 0 for one that was not needed.

        Raises
        ------
        EstimationError
            No parameter has this name.
        """
        return self._of(name, self.standard_deviations)

    @property
    def moving_mass(self) -> float:
        """All that moves: the mass and those that swing on it."""
        return float(self._of_masses @ self.estimates) if "mass" in self.names else self.known_mass

    @property
    def moving_mass_sd(self) -> float:
        """Standard deviation of ``moving_mass``; NaN where the mass was given."""
        if "mass" not in self.names:
            return float("nan")
        return float(np.sqrt(self._of_masses @ self.covariance @ self._of_masses))

    @property
    def _of_masses(self) -> FloatArray:
        return np.array([float(name == "mass" or name.startswith("modal_mass_")) for name in self.names])

    @property
    def resistance_forward(self) -> float:
        """Dry friction and constant force together, against motion along +x."""
        return self.value("coulomb") + self._half

    @property
    def resistance_backward(self) -> float:
        """Dry friction less constant force, against motion along -x."""
        return self.value("coulomb") - self._half

    @property
    def _half(self) -> float:
        if "offset" in self.names:
            return self.value("offset")
        return self.known_offset + 0.5 * self.value("coulomb_difference")

    def summary_parts(self) -> list[SummaryPart]:
        """Return a table of the parameters with standard deviations and 95 % intervals, and what to know of them."""
        rows = []
        for name, unit, value, sd in zip(
            self.names, self.units, self.estimates, self.standard_deviations, strict=True
        ):
            ends = f"{value - 1.96 * sd:.6g}", f"{value + 1.96 * sd:.6g}"
            rows.append((f"{meaning_of(name)} [{unit}]", f"{value:.6g}", f"{sd:.2g}", *ends))
        by = f"{self.method.replace('_', ' ')}, {self.n_samples} positions in {self.n_pieces} stretches of motion"
        return [
            SummaryTable(("", "estimate", "sd", "95 % from", "to"), tuple(rows)),
            by,
            *([self.drive_verdict] if self.drive_verdict else []),
            self.check.verdict,
            *(f"note: {warning}" for warning in self.warnings),
        ]

    @property
    def is_compliant(self) -> bool:
        """Whether the drive's spring was found."""
        return "stiffness" in self.names

    @property
    def drive_resonance(self) -> float:
        """At which drive and hub swing against each other without friction [rad/s]; 0 without a spring."""
        if not self.is_compliant:
            return 0.0
        mass, drive = self.value("mass"), self._drive_mass
        return float(np.sqrt(self.value("stiffness") * mass / (drive * (mass - drive))))

    @property
    def _drive_mass(self) -> float:
        return self.value("drive_mass") if "drive_mass" in self.names else self.known_drive_mass

    @property
    def drive_verdict(self) -> str:
        """What the record says of the drive's spring, in one sentence; empty where nobody asked."""
        if self.is_compliant:
            frequency_hz = self.drive_resonance / (2.0 * np.pi)
            return f"the drive is compliant: it swings against the hub at {frequency_hz:.4g} Hz"
        if np.isnan(self.stiffer_than):
            return ""
        words = (
            f"the drive is stiff as far as the record shows: stiffer than {self.stiffer_than:.3g} N/m (95 %)"
        )
        return words if not np.isnan(self.known_drive_mass) else f"{words}, whatever its mass"

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers, from which it is rebuilt exactly (also through JSON)."""
        return written(self, "axis", SCHEMA)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> AxisResult:
        """Rebuild what ``to_dict`` wrote.

        Raises
        ------
        ModelFormatError
            Another type or schema, a missing entry, or entries that do not agree.
        """
        found = read(AxisResult, data, "axis", SCHEMA)
        n = len(found.names)
        require_shapes(
            "axis",
            found,
            {
                "estimates": (n,),
                "units": (n,),
                "covariance": (n, n),
                "other_estimates": (4,),
                "other_sd": (4,),
            },
        )
        return found

    def _of(self, name: str, values: FloatArray) -> float:
        if name in self.names:
            return float(values[self.names.index(name)])
        if name in ("delay", "viscous_difference") or name.startswith("modal_mass_"):
            return 0.0
        raise EstimationError(f"the axis has no parameter {name!r}; expected one of {', '.join(self.names)}")


def meaning_of(name: str) -> str:
    """Return what a parameter is, in words."""
    if name.startswith("modal_mass_"):
        return f"mass that swings in mode {name.removeprefix('modal_mass_')}"
    return MEANINGS[name]


def in_known_units(
    estimates: FloatArray, covariance: FloatArray, mass: float, mass_sd: float
) -> tuple[FloatArray, FloatArray]:
    """Turn parameters for a unit of the input into newtons by a known mass.

    Parameters
    ----------
    estimates : ndarray, shape (n,) -- the mass first, a delay, if there is one, last and left as it is
    covariance : ndarray, shape (n, n)
    mass, mass_sd : float -- [kg]

    Returns
    -------
    estimates, covariance -- the force constant first [N for a unit of the input]
    """
    n = len(estimates)
    constant = mass / estimates[0]
    found = constant * estimates
    found[0] = constant
    # k = M / m, and p_j = k p_j(unit): derivatives by every estimate, and by M.
    slopes = constant * np.eye(n)
    slopes[:, 0] = -found / estimates[0]
    slopes[0, 0] = -constant / estimates[0]
    by_mass = found / mass
    return found, slopes @ covariance @ slopes.T + mass_sd**2 * np.outer(by_mass, by_mass)


def units_of(names: tuple[str, ...], unit: str, in_newtons: bool) -> tuple[str, ...]:
    """Return the units of parameters under an input of some unit.

    Parameters
    ----------
    names : tuple of str
    unit : str -- of the input
    in_newtons : bool -- whether a known mass has turned it into newtons
    """
    force = "N" if in_newtons else unit
    known = {
        "mass": "kg" if force == "N" else f"{force} s^2/m",
        "force_constant": f"N/{unit}",
        "viscous": f"{force} s/m",
        "viscous_difference": f"{force} s/m",
        "delay": "s",
        "stiffness": f"{force}/m",
        "drive_damping": f"{force} s/m",
    }
    return tuple(
        known["mass"] if name.startswith("modal_mass_") or name == "drive_mass" else known.get(name, force)
        for name in names
    )
