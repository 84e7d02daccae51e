"""A continuous-time transfer function B(s)/A(s) e^(-s T) with its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beam_ident.errors import EstimationError, ModelFormatError
from beam_ident.piecewise import FloatArray, Instants
from beam_ident.rational_response import RationalResponse, upper_roots
from beam_ident.records import InputSignal

SCHEMA = 1


@dataclass(frozen=True, eq=False)
class TransferFunctionModel:
    """A single-input, single-output continuous-time model.

    Attributes
    ----------
    numerator : ndarray, shape (n_zeros + 1,) -- b_0 .. b_m, descending powers of s
    denominator : ndarray, shape (n_poles + 1,) -- 1, a_1 .. a_n, descending powers of s
    delay : float -- pure delay T [s]
    covariance : ndarray -- of (a_1 .. a_n, b_0 .. b_m, T)
    noise_sd : float -- of the residuals
    input_name, output_name : str
    """

    numerator: FloatArray
    denominator: FloatArray
    delay: float
    covariance: FloatArray
    noise_sd: float
    input_name: str = "u"
    output_name: str = "y"

    def __post_init__(self) -> None:
        for name in ("numerator", "denominator", "covariance"):
            values = np.array(getattr(self, name), dtype=np.float64, copy=True)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        n = len(self.denominator) - 1 + len(self.numerator) + 1
        if self.covariance.shape != (n, n) or self.denominator[0] != 1.0:
            raise ModelFormatError(
                f"transfer function: covariance of shape {self.covariance.shape} and leading denominator "
                "coefficient "
                f"{self.denominator[0]}; expected {(n, n)} and 1"
            )

    @property
    def n_poles(self) -> int:
        """Degree of the denominator."""
        return len(self.denominator) - 1

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names in the order of the covariance."""
        a = [f"a{i}" for i in range(1, self.n_poles + 1)]
        b = [f"b{j}" for j in range(len(self.numerator))]
        return (*a, *b, "delay")

    @property
    def parameters(self) -> FloatArray:
        """Parameters in the order of the covariance."""
        return np.concatenate([self.denominator[1:], self.numerator, [self.delay]])

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations in the order of the covariance."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles [rad/s]."""
        return np.asarray(np.roots(self.denominator), dtype=np.complex128)

    @property
    def zeros(self) -> NDArray[np.complex128]:
        """Zeros [rad/s]."""
        return np.asarray(np.roots(self.numerator), dtype=np.complex128)

    def pole_sensitivities(self, poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return d pole / d a_i, shape (n_given, n_poles)."""
        slope = np.polyval(np.polyder(self.denominator), poles)
        powers = np.arange(self.n_poles - 1, -1, -1)
        return np.asarray(-(poles[:, None] ** powers) / slope[:, None])

    def modes(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return natural frequencies [rad/s], damping ratios and the standard deviations of both.

        Complex pairs only, in order of frequency.
        """
        poles = self.poles
        poles = poles[poles.imag > 0.0]
        poles = poles[np.argsort(np.abs(poles))]
        omega = np.abs(poles)
        by_a = self.pole_sensitivities(poles)
        by_omega = np.real(np.conj(poles)[:, None] * by_a) / omega[:, None]
        zeta = -poles.real / omega
        by_zeta = -by_a.real / omega[:, None] - (zeta / omega)[:, None] * by_omega
        covariance = self.covariance[: self.n_poles, : self.n_poles]
        sd = [
            np.sqrt(np.maximum(np.einsum("ka,ab,kb->k", g, covariance, g), 0.0)) for g in (by_omega, by_zeta)
        ]
        return omega, zeta, sd[0], sd[1]

    def simulate(self, drive: InputSignal, times_s: FloatArray, exposure_s: float = 0.0) -> FloatArray:
        """Return the output that an input causes from rest, shape (n_times,).

        Parameters
        ----------
        drive : InputSignal
        times_s : ndarray, shape (n_times,) -- inside the input's span [s]
        exposure_s : float -- box average centred on each instant [s]
        """
        first, last = drive.span_s
        times = np.asarray(times_s, dtype=np.float64)
        if len(times) and (
            times.min() - exposure_s / 2 < first - 1e-9 or times.max() + exposure_s / 2 > last + 1e-9
        ):
            raise EstimationError(
                f"instants from {times.min():.6f} to {times.max():.6f} s are asked for; input "
                f"{drive.name!r} is known "
                f"from {first:.6f} to {last:.6f} s"
            )
        signal = drive.signal(margin_s=max(self.delay, 0.0) + exposure_s, from_rest=True)
        integral = signal.antiderivative()
        instants = Instants.on(signal, times - self.delay, exposure_s)
        scale = max(float(np.exp(np.mean(np.log(np.maximum(np.abs(self.poles), 1e-9))))), 1e-9)
        scaled = self.denominator / scale ** np.arange(self.n_poles + 1)
        response = RationalResponse(upper_roots(scaled), scale, signal, integral, instants, squares=False)
        total = np.zeros(len(times))
        for power, coefficient in enumerate(self.numerator[::-1]):
            total += coefficient * scale ** (power - self.n_poles) * response.over(power)
        return total

    def step_response(self, times_s: FloatArray) -> FloatArray:
        """Return the response to a unit step at 0 s, shape (n_times,)."""
        times = np.asarray(times_s, dtype=np.float64)
        end = max(float(np.max(times, initial=0.0)), 1e-9)
        return self.simulate(InputSignal("step", "", np.array([0.0, end]), np.ones(2), "zoh"), times)

    def frequency_response(self, omegas: FloatArray) -> tuple[NDArray[np.complex128], FloatArray]:
        """Return the response and the standard deviation of its magnitude, both shape (n_frequencies,).

        Parameters
        ----------
        omegas : ndarray, shape (n_frequencies,) -- [rad/s]
        """
        s = 1j * np.asarray(omegas, dtype=np.float64)
        bottom = np.polyval(self.denominator, s)
        lag = np.exp(-s * self.delay)
        response = np.polyval(self.numerator, s) / bottom * lag
        powers_a = s[:, None] ** np.arange(self.n_poles - 1, -1, -1)
        powers_b = s[:, None] ** np.arange(len(self.numerator) - 1, -1, -1)
        gradient = np.concatenate(
            [
                -(response / bottom)[:, None] * powers_a,
                (lag / bottom)[:, None] * powers_b,
                (-s * response)[:, None],
            ],
            axis=1,
        )
        unit = response / np.maximum(np.abs(response), 1e-300)
        along = np.real(np.conj(unit)[:, None] * gradient)
        variance = np.einsum("fa,ab,fb->f", along, self.covariance, along, optimize=True)
        return np.asarray(response), np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def to_scipy(self) -> Any:
        """Return a :class:`scipy.signal.TransferFunction`; a delay must be carried apart."""
        from scipy.signal import TransferFunction

        if self.delay != 0.0:
            raise EstimationError(
                f"scipy.signal has no delays and this model has one of {self.delay:.6g} s; use numerator, "
                "denominator "
                "and delay, or simulate()"
            )
        return TransferFunction(self.numerator, self.denominator)

    def to_control(self) -> Any:
        """Return a python-control ``TransferFunction`` (needs the package ``control``)."""
        try:
            import control
        except ImportError as err:
            raise EstimationError("python-control is not installed; `pip install control` brings it") from err
        if self.delay != 0.0:
            raise EstimationError(
                f"python-control has no exact delays and this model has one of {self.delay:.6g} s; use a "
                "Pade "
                "approximation of your own, or simulate()"
            )
        return control.tf(self.numerator, self.denominator)

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain lists and numbers, from which it is rebuilt exactly."""
        return {
            "schema": SCHEMA,
            "type": "transfer_function",
            "numerator": self.numerator.tolist(),
            "denominator": self.denominator.tolist(),
            "delay_s": self.delay,
            "covariance": self.covariance.tolist(),
            "noise_sd": self.noise_sd,
            "input_name": self.input_name,
            "output_name": self.output_name,
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> TransferFunctionModel:
        """Rebuild a model written by :meth:`to_dict`.

        Raises
        ------
        ModelFormatError
            Another type or schema, or a missing entry.
        """
        if data.get("type") != "transfer_function" or data.get("schema") != SCHEMA:
            raise ModelFormatError(
                f"this is a {data.get('type')!r} of schema {data.get('schema')!r}; expected a "
                "'transfer_function' of "
                f"schema {SCHEMA}"
            )
        try:
            return TransferFunctionModel(
                np.asarray(data["numerator"], dtype=np.float64),
                np.asarray(data["denominator"], dtype=np.float64),
                float(data["delay_s"]),
                np.asarray(data["covariance"], dtype=np.float64),
                float(data["noise_sd"]),
                str(data["input_name"]),
                str(data["output_name"]),
            )
        except KeyError as err:
            raise ModelFormatError(f"transfer function: the entry {err} is missing") from err
