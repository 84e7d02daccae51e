"""A continuous-time transfer function B(s)/A(s) e^(-s T) with its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import finite_row, require_input_signal, require_record, require_time
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.data.stored_form import checked_entries, complaints_about, plain
from beam_ident.errors import EstimationError, ModelFormatError
from beam_ident.numerics.piecewise import Instants
from beam_ident.numerics.rational_response import RationalResponse, poles_keep_apart, upper_roots
from beam_ident.summary import SummarisedModes, SummaryPart, estimates_table, modes_table
from beam_ident.transfer_function.output_prediction import OutputPrediction

SCHEMA = 1


@dataclass(frozen=True, eq=False, repr=False)
class TransferFunctionModel(SummarisedModes):
    """A single-input, single-output continuous-time model.

    Attributes
    ----------
    numerator : ndarray, shape (n_zeros + 1,) -- b_0 .. b_m, descending powers of s
    denominator : ndarray, shape (n_poles + 1,) -- 1, a_1 .. a_n, descending powers of s; coefficients at its
        end that are exactly zero are known integrators
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
        sizes = [self.numerator.ndim, self.denominator.ndim, len(self.numerator), len(self.denominator)]
        if min(sizes) < 1 or max(sizes[:2]) > 1:
            raise ModelFormatError(
                f"transfer function: numerator of shape {self.numerator.shape} and denominator of shape "
                f"{self.denominator.shape}; expected a row of coefficients each"
            )
        if not np.all(np.isfinite([*self.numerator, *self.denominator, self.delay])):
            raise ModelFormatError(
                f"transfer function: {self.numerator} over {self.denominator} with a delay of {self.delay} s; "
                "expected finite numbers"
            )
        n = len(self.denominator) - 1 + len(self.numerator) + 1
        if self.covariance.shape != (n, n) or self.denominator[0] != 1.0:
            raise ModelFormatError(
                f"transfer function: covariance of shape {self.covariance.shape} and leading denominator "
                f"coefficient {self.denominator[0]}; expected {(n, n)} and 1"
            )

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        names, values, sds = self.parameter_names, self.parameters, self.standard_deviations
        shown = [k for k, name in enumerate(names) if name != "delay" or self.delay or sds[k]]
        return [
            f"{self.input_name} -> {self.output_name}: {len(self.numerator) - 1} zeros, {self.n_poles} poles",
            modes_table(*self.modes()),
            estimates_table([names[k] for k in shown], values[shown], sds[shown]),
        ]

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
    def n_integrators(self) -> int:
        """Number of poles that are exactly zero."""
        return self.n_poles - int(np.max(np.flatnonzero(self.denominator)))

    @property
    def poles(self) -> ComplexArray:
        """Poles [rad/s]."""
        return np.asarray(np.roots(self.denominator), dtype=np.complex128)

    @property
    def zeros(self) -> ComplexArray:
        """Zeros [rad/s]."""
        return np.asarray(np.roots(self.numerator), dtype=np.complex128)

    def zpk(self) -> tuple[ComplexArray, ComplexArray, float]:
        """Return zeros [rad/s], poles [rad/s] and the gain of the highest power."""
        leading = self.numerator[np.flatnonzero(self.numerator)] if np.any(self.numerator) else np.zeros(1)
        return self.zeros, self.poles, float(leading[0])

    def residues(self) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """Return residues, poles [rad/s] and the polynomial part (descending powers) of the partial fractions.

        Raises
        ------
        EstimationError
            Poles that coincide, two integrators among them: there are no simple fractions then.
        """
        poles = self.poles
        if self.n_integrators > 1 or not poles_keep_apart(poles):
            raise EstimationError(
                "poles of this transfer function coincide, so that it has no simple fractions; use state_space()"
            )
        direct, rest = np.polydiv(self.numerator, self.denominator)
        residues = np.polyval(rest, poles) / np.polyval(np.polyder(self.denominator), poles)
        return residues, poles, np.trim_zeros(np.atleast_1d(direct), "f")

    def state_space(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return A (n, n), B (n, 1), C (1, n) and D (1, 1) of ``x' = A x + B u(t - T), y = C x + D u(t - T)``.

        Notes
        -----
        The controllable form, its states scaled by powers of the mean modulus of the poles so
        that the matrices keep their digits.
        """
        n, scale = self.n_poles, self._scale
        if len(self.numerator) > n + 1:
            raise EstimationError(
                f"{len(self.numerator) - 1} zeros and {n} poles: an improper model has no state space"
            )
        a = self.denominator[1:] / scale ** np.arange(1, n + 1)
        b = np.concatenate([np.zeros(n + 1 - len(self.numerator)), self.numerator])
        b = b / scale ** np.arange(0, n + 1)
        transition = scale * np.eye(n, k=-1)
        transition[0] = -scale * a
        entry = np.zeros((n, 1))
        entry[0, 0] = scale
        return transition, entry, (b[1:] - b[0] * a)[None], np.array([[b[0]]])

    @property
    def _scale(self) -> float:
        """Unit of frequency in which the coefficients are of like size [rad/s]."""
        size = np.abs(self.poles)
        size = size[size > 0.0]
        return float(np.exp(np.mean(np.log(size)))) if len(size) else 1.0

    def pole_sensitivities(self, poles: ComplexArray) -> ComplexArray:
        """Return d pole / d a_i, shape (n_given, n_poles); zero for known integrators."""
        slope = np.polyval(np.polyder(self.denominator), poles)
        powers = np.arange(self.n_poles - 1, -1, -1)
        is_known = poles == 0.0
        result = -(poles[:, None] ** powers) / np.where(is_known, 1.0, slope)[:, None]
        return np.asarray(np.where(is_known[:, None], 0.0, result))

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

    def real_poles(self) -> tuple[FloatArray, FloatArray]:
        """Return the real poles [rad/s] and their standard deviations, the slowest first.

        Known integrators are left out.
        """
        poles = self.poles
        poles = poles[(poles.imag == 0.0) & (poles != 0.0)]
        poles = poles[np.argsort(np.abs(poles))]
        by_a = np.real(self.pole_sensitivities(poles))
        covariance = self.covariance[: self.n_poles, : self.n_poles]
        variance = np.einsum("ka,ab,kb->k", by_a, covariance, by_a)
        return np.asarray(poles.real), np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def simulate(self, drive: InputSignal, times_s: FloatArray, exposure_s: float = 0.0) -> FloatArray:
        """Return the output that an input causes from rest, shape (n_times,).

        Parameters
        ----------
        drive : InputSignal
        times_s : ndarray, shape (n_times,) -- inside the input's span [s]
        exposure_s : float -- box average centred on each instant [s]
        """
        times = finite_row("instants [s]", times_s)
        response = self._response(drive, times, exposure_s, squares=False)
        return response.combined(self._scaled_numerator()[None])[:, 0]

    def simulation_sd(self, drive: InputSignal, times_s: FloatArray, exposure_s: float = 0.0) -> FloatArray:
        """Return the standard deviation of ``simulate`` that the parameters' covariance causes, (n_times,)."""
        times = finite_row("instants [s]", times_s)
        response = self._response(drive, times, exposure_s, squares=True)
        scale, n, ascending = self._scale, response.order, self._scaled_numerator()
        gradient = np.zeros((len(times), len(self.parameters)))
        products = np.zeros((n, n - 1 + len(ascending)))
        for i in range(n):
            products[i, n - 1 - i : n - 1 - i + len(ascending)] = -ascending
        gradient[:, :n] = response.combined(products, squared=True) / scale ** np.arange(1, n + 1)
        m = len(ascending) - 1
        powers = response.combined(np.eye(m + 1)[::-1])
        gradient[:, self.n_poles : self.n_poles + m + 1] = powers * scale ** (np.arange(m, -1, -1.0) - n)
        by_time = response.combined(np.concatenate([[0.0], ascending])[None])[:, 0]
        gradient[:, -1] = -scale * by_time
        variance = np.einsum("ta,ab,tb->t", gradient, self.covariance, gradient, optimize=True)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def _scaled_numerator(self) -> FloatArray:
        """Return the numerator over powers of s / scale, ascending, for the denominator without integrators."""
        n = self.n_poles - self.n_integrators
        ascending = self.numerator[::-1]
        return ascending * self._scale ** (np.arange(len(ascending)) - float(n))

    def _response(
        self, drive: InputSignal, times: FloatArray, exposure_s: float, squares: bool
    ) -> RationalResponse:
        require_input_signal(drive)
        require_time("exposure_s", exposure_s)
        first, last = drive.span_s
        half = 0.5 * exposure_s
        if len(times) and (times.min() - half < first - 1e-9 or times.max() + half > last + 1e-9):
            raise EstimationError(
                f"instants from {times.min():.6f} to {times.max():.6f} s are asked for; input "
                f"{drive.name!r} is known from {first:.6f} to {last:.6f} s"
            )
        signal = drive.signal(margin_s=max(abs(self.delay) + exposure_s, 1e-12), from_rest=True)
        for _ in range(self.n_integrators):
            signal = signal.antiderivative()
        instants = Instants.on(signal, np.maximum(times - self.delay, signal.knots[0] + half), exposure_s)
        n = self.n_poles - self.n_integrators
        scaled = self.denominator[: n + 1] / self._scale ** np.arange(n + 1)
        return RationalResponse(
            upper_roots(scaled), self._scale, signal, signal.antiderivative(), instants, squares
        )

    def predict(self, record: TimeRecord) -> FloatArray:
        """Return what the model predicts at an output's stamps, shape (n_samples,).

        Parameters
        ----------
        record : TimeRecord -- with the model's input and output under their names

        Notes
        -----
        The simulation with the record's own offset and initial state (``transfer_function.output_prediction``);
        NaN where the input is not known.
        """
        return self.prediction(record).everywhere()

    def prediction(self, record: TimeRecord) -> OutputPrediction:
        """Return the output beside its prediction."""
        require_record(record)
        drive = record.input(self.input_name)

        def simulate(times: FloatArray, exposure_s: float) -> FloatArray:
            return self.simulate(drive, times, exposure_s)

        return OutputPrediction.of(record.output(self.output_name), [drive], simulate, self.free_motions)

    def free_motions(self, elapsed: FloatArray, exposure_s: float) -> FloatArray:
        """Return a constant, what integrators do on their own, and the free motions, as columns."""
        n = self.n_poles - self.n_integrators
        scaled = self.denominator[: n + 1] / self._scale ** np.arange(n + 1)
        free = RationalResponse.to_impulse(
            upper_roots(scaled), self._scale, elapsed, exposure_s, squares=False
        )
        span = max(float(np.max(elapsed, initial=0.0)), 1e-300)
        drifts = (elapsed[:, None] / span) ** np.arange(max(self.n_integrators, 1))
        return np.concatenate([drifts, free.combined(np.eye(n))], axis=1)

    def step_response(self, times_s: FloatArray) -> FloatArray:
        """Return the response to a unit step at 0 s, shape (n_times,)."""
        times = finite_row("instants [s]", times_s)
        return self.simulate(_unit_step(times), times)

    def step_response_sd(self, times_s: FloatArray) -> FloatArray:
        """Return the standard deviation of ``step_response``, shape (n_times,)."""
        times = finite_row("instants [s]", times_s)
        return self.simulation_sd(_unit_step(times), times)

    def frequency_response(self, omegas: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Return the response and the standard deviation of its magnitude, both shape (n_frequencies,).

        Parameters
        ----------
        omegas : ndarray, shape (n_frequencies,) -- [rad/s]
        """
        s = 1j * finite_row("frequencies [rad/s]", omegas)
        bottom = np.polyval(self.denominator, s)
        if np.any(bottom == 0.0):
            raise EstimationError(
                f"this model has a pole at {s[bottom == 0.0][0].imag:.6g} rad/s on the imaginary axis; its response "
                "there is infinite. Leave that frequency out"
            )
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
        """Return a ``scipy.signal.TransferFunction``; a delay must be carried apart."""
        from scipy.signal import TransferFunction

        if self.delay != 0.0:
            raise EstimationError(
                f"scipy.signal has no delays and this model has one of {self.delay:.6g} s; use numerator, "
                "denominator and delay, or simulate()"
            )
        return TransferFunction(self.numerator, self.denominator)

    def to_control(self, pade_order: int | None = None) -> Any:
        """Return a python-control ``TransferFunction`` (needs the package ``control``).

        Parameters
        ----------
        pade_order : int or None
            Order of the Pade approximation that stands for the delay; python-control has no exact one.
        """
        try:
            import control
        except ImportError as err:
            raise EstimationError("python-control is not installed; `pip install control` brings it") from err
        rational = control.tf(self.numerator, self.denominator)
        if self.delay == 0.0:
            return rational
        if pade_order is None:
            raise EstimationError(
                f"python-control has no exact delays and this model has one of {self.delay:.6g} s; give "
                "pade_order, or use simulate()"
            )
        return rational * control.tf(*control.pade(self.delay, pade_order))

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain lists and numbers, from which it is rebuilt exactly."""
        entries = {
            "schema": SCHEMA,
            "type": "transfer_function",
            "numerator": self.numerator,
            "denominator": self.denominator,
            "delay_s": self.delay,
            "covariance": self.covariance,
            "noise_sd": self.noise_sd,
            "input_name": self.input_name,
            "output_name": self.output_name,
        }
        return {name: plain(value) for name, value in entries.items()}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> TransferFunctionModel:
        """Rebuild a model written by ``to_dict``.

        Raises
        ------
        ModelFormatError
            Another type or schema, or a missing entry.
        """
        data = checked_entries(data, "transfer_function", SCHEMA)
        with complaints_about("transfer function"):
            return TransferFunctionModel(
                np.asarray(data["numerator"], dtype=np.float64),
                np.asarray(data["denominator"], dtype=np.float64),
                float(data["delay_s"]),
                np.asarray(data["covariance"], dtype=np.float64),
                float(data["noise_sd"]),
                str(data["input_name"]),
                str(data["output_name"]),
            )


def _unit_step(times: FloatArray) -> InputSignal:
    end = max(float(np.max(times, initial=0.0)), 1e-9)
    return InputSignal("step", "", np.array([0.0, end]), np.ones(2), "zoh")
