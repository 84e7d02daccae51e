"""The numbers of a report, computed anew from the bag and the model file by other code.

    python -m benchmarks.recomputed_report BAG REPORT_FOLDER

Nothing of the suite is used: messages are read by rosbags, the model is simulated by its differential equations, and
the page is read as text. It goes with reports of the modal estimator, of one bag with the hub's position as input,
whose samples begin with the excitation or shortly before. Every number that the page prints is held against the one
computed here; one that differs by more than its tolerance is named, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.signal import cont2discrete, lfilter
from scipy.stats import chi2

STEP_S = 1e-4  # of the simulation: ten steps to a sample of the hub
SHARE = 2e-2  # of a noise's deviation, of a score's distance from 100 %: how many parameters a fit has weighs so much
LAGS = 25


@dataclass(frozen=True)
class Compared:
    """A number of the page, as it is printed and as it is computed here; how far they may be apart."""

    name: str
    printed: str
    value: float
    tolerance: float

    @property
    def agrees(self) -> bool:
        """Whether they differ by less than the tolerance, or by half of the last digit that is printed."""
        return abs(_number(self.printed) - self.value) <= max(
            self.tolerance, 0.51 * _last_digit(self.printed)
        )


def _number(text: str) -> float:
    return float(text.replace("\N{MINUS SIGN}", "-").split()[0])


def _last_digit(text: str) -> float:
    """Return the size of the last digit of a printed number."""
    mantissa, _, power = text.split()[0].lower().partition("e")
    return 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))


class _Tables(HTMLParser):
    """The cells of a page's tables, row by row, and all its text."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.text = ""
        self._is_cell = False

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self._is_cell = True

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self._is_cell = False

    def handle_data(self, data: str) -> None:
        self.text += data
        if self._is_cell:
            self.tables[-1][-1][-1] += data

    def rows(self, *columns: str) -> dict[str, dict[str, str]]:
        """Return the table that has columns: by the first cell of every row, its cells by column."""
        for table in self.tables:
            head = [cell.strip() for cell in table[0]] if table else []
            if set(columns) <= set(head):
                return {
                    row[0].strip(): dict(zip(head, map(str.strip, row), strict=False)) for row in table[1:]
                }
        raise LookupError(f"no table with the columns {columns}")


@dataclass(frozen=True)
class Signals:
    """Times [s] and positions [m] of the hub, and of every marker that was seen."""

    hub: tuple[np.ndarray, np.ndarray]
    markers: dict[str, tuple[np.ndarray, np.ndarray]]
    exposure_s: float


def signals_of(bag: Path, first_s: float, last_s: float) -> Signals:
    """Read hub and markers, and keep the markers between two times after the hub's first sample [s]."""
    hub_ns, hub_m, marker_ns = [], [], []
    seen: dict[str, list[float]] = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, data in reader.messages():
            topic = connection.topic.removeprefix("/")
            if topic not in ("hub/measured", "beam/displacement", "excitation/info"):
                continue
            message: Any = reader.deserialize(data, connection.msgtype)
            if topic == "excitation/info":
                rig = json.loads(message.data)["rig"]
                continue
            stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            if topic == "hub/measured":
                for point in message.points:
                    since = point.time_from_start
                    hub_ns.append(stamp_ns + since.sec * 1_000_000_000 + since.nanosec)
                    hub_m.append(float(point.positions[0]))
            else:
                marker_ns.append(stamp_ns)
                for name, position in zip(message.name, message.position, strict=True):
                    seen.setdefault(name, []).append(float(position))
    hub_s = (np.array(hub_ns) - hub_ns[0]) * 1e-9
    times_s = (np.array(marker_ns) - hub_ns[0]) * 1e-9
    inside = (times_s >= first_s - 5e-4) & (times_s <= last_s + 5e-4)
    markers = {}
    for name, positions in seen.items():
        usable = inside & np.isfinite(positions)
        markers[name] = times_s[usable], np.array(positions)[usable]
    return Signals((hub_s, np.array(hub_m)), markers, float(rig["camera"]["exposure"]))


def free_and_forced(model: dict[str, Any], signals: Signals, first_s: float) -> tuple[Any, Any, Any]:
    """Return functions of time, averaged over the exposure: the hub, forced modes, and free motions of the modes.

    A mode q'' + 2 zeta omega q' + omega^2 q = alpha'' is q = alpha - p, with p'' + 2 zeta omega p' + omega^2 p =
    2 zeta omega alpha' + omega^2 alpha: the hub's acceleration is not needed. It starts from rest at the first time.
    """
    spline = CubicSpline(*signals.hub)
    begin, end = max(first_s, float(signals.hub[0][0])), float(signals.hub[0][-1])
    grid = np.arange(begin, end, STEP_S)
    hub = spline(grid)
    columns = [hub, spline(grid, 2)]
    elapsed = grid - begin
    for omega, zeta in zip(model["natural_frequencies_rad_s"], model["damping_ratios"], strict=True):
        plant = [2.0 * zeta * omega, omega**2], [1.0, 2.0 * zeta * omega, omega**2]
        numerator, denominator, _ = cont2discrete(plant, STEP_S, method="foh")
        forced = lfilter(np.ravel(numerator), denominator, hub - hub[0]) + hub[0]
        columns.append(hub - forced)
        pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
        columns += [np.exp(pole * elapsed).real, np.exp(pole * elapsed).imag]
    integrals = cumulative_trapezoid(np.array(columns), dx=STEP_S, axis=1, initial=0.0)
    half = 0.5 * signals.exposure_s

    def at(times_s: np.ndarray) -> np.ndarray:
        ends = [[np.interp(times_s + side, grid, own) for own in integrals] for side in (half, -half)]
        return (np.array(ends[0]) - np.array(ends[1])) / (2.0 * half)

    n = len(model["natural_frequencies_rad_s"])
    is_mode = slice(2, 2 + 3 * n, 3)
    is_free = np.array([k for k in range(2, 2 + 3 * n) if (k - 2) % 3])
    return (lambda t: at(t)[:2]), (lambda t: at(t)[is_mode]), (lambda t: at(t)[is_free])


def fitted(
    model: dict[str, Any], signals: Signals, first_s: float
) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return measured, modelled and direct part of every output; initial motion, offsets and drifts are fitted."""
    hub_of, forced_of, free_of = free_and_forced(model, signals, first_s)
    names = list(signals.markers)
    known, rows, places = {}, [], []
    n, m = len(model["damping_ratios"]), len(names)
    for j, name in enumerate(model["output_names"]):
        times_s, measured = signals.markers[name]
        middle_s = 0.5 * (times_s[0] + times_s[-1])
        own = middle_s + (1.0 - model["clock_rate"]) * (times_s - model["latency_s"] - middle_s)
        (hub, acceleration), residues = hub_of(own), np.array(model["residues"][j])
        direct = model["gains"][j] * hub
        forced = direct - residues @ forced_of(own) - model["residual_terms"][j] * acceleration
        columns = np.zeros((len(times_s), 2 * n + 2 * m))
        columns[:, : 2 * n] = (np.repeat(residues, 2)[:, None] * free_of(own)).T
        columns[:, 2 * n + 2 * j] = 1.0
        columns[:, 2 * n + 2 * j + 1] = times_s - np.mean(times_s)
        known[name] = measured, forced, direct, columns
        rows.append(columns / model["noise_sd"][j])
        places.append((measured - forced) / model["noise_sd"][j])
    found = np.linalg.lstsq(np.vstack(rows), np.concatenate(places), rcond=None)[0]
    return {
        name: (measured, forced + columns @ found, direct + columns[:, 2 * n :] @ found[2 * n :])
        for name, (measured, forced, direct, columns) in known.items()
    }


def fit_percent(measured: np.ndarray, modelled: np.ndarray) -> float:
    """Return 100 (1 - |y - model| / |y - mean|) (Ljung 1999, section 16.4)."""
    return float(
        100.0 * (1.0 - np.linalg.norm(measured - modelled) / np.linalg.norm(measured - measured.mean()))
    )


def whiteness_p(residuals: np.ndarray) -> float:
    """Return how often white noise would look less white (Ljung and Box 1978)."""
    e, n = residuals - residuals.mean(), len(residuals)
    r = np.array([e[k:] @ e[: n - k] for k in range(1, LAGS + 1)]) / (e @ e)
    return float(chi2.sf(n * (n + 2) * np.sum(r**2 / (n - np.arange(1, LAGS + 1))), LAGS))


def response(model: dict[str, Any], parameters: np.ndarray, output: int, omega: float) -> complex:
    """Return H(i omega) of an output, from all parameters in their order."""
    n = len(model["damping_ratios"])
    omegas, zetas = parameters[:n], parameters[n : 2 * n]
    c, rest, *residues = parameters[2 * n + 2 + output * (n + 2) :][: n + 2]
    s = 1j * omega
    modes = np.array(residues) / (s**2 + 2.0 * zetas * omegas * s + omegas**2)
    return complex(c - s**2 * (np.sum(modes) + rest))


def magnitude_sd(model: dict[str, Any], output: int, omega: float) -> float:
    """Return the standard deviation of |H(i omega)|, by differences along every parameter."""
    parameters, covariance = parameters_of(model), np.array(model["covariance"])
    sds = np.sqrt(np.diag(covariance))
    slopes = np.zeros(len(parameters))
    for k in np.flatnonzero(sds):
        moved = [
            parameters + side * 1e-3 * sds[k] * (np.arange(len(parameters)) == k) for side in (1.0, -1.0)
        ]
        ends = [abs(response(model, own, output, omega)) for own in moved]
        slopes[k] = (ends[0] - ends[1]) / (2e-3 * sds[k])
    return float(np.sqrt(slopes @ covariance @ slopes))


def parameters_of(model: dict[str, Any]) -> np.ndarray:
    """Return all parameters in the order of the covariance."""
    parts = [
        model["natural_frequencies_rad_s"],
        model["damping_ratios"],
        [model["latency_s"], model["clock_rate"]],
    ]
    for gain, rest, residues in zip(model["gains"], model["residual_terms"], model["residues"], strict=True):
        parts.append([gain, rest, *residues])
    return np.concatenate(parts)


def compared(bag: Path, folder: Path) -> Iterator[Compared]:
    """Yield every number of a report that is computed here, beside the page's."""
    document = json.loads((folder / "model.json").read_text())
    model, summary = document["model"], document["summary"]
    page = _Tables()
    page.feed((folder / "report.html").read_text().replace("\N{NO-BREAK SPACE}", " "))
    quality = page.rows("signal", "first [s]", "rate [1/s]")
    yield from _of_modes(model, summary, page, list(csv.DictReader((folder / "poles.csv").open())))
    first_s, last_s = (float(quality[model["output_names"][0]][name]) for name in ("first [s]", "last [s]"))
    signals = signals_of(bag, first_s, last_s)
    hub_first_s = float(quality["hub"]["first [s]"])
    scores = page.rows("output", "FIT [%]", "noise sd")
    for name, (measured, modelled, direct) in fitted(model, signals, hub_first_s).items():
        row, fit = scores[name], fit_percent(measured, modelled)
        residuals = measured - modelled
        yield Compared(f"{name}: samples", row["samples"], len(measured), 0.0)
        yield Compared(f"{name}: FIT [%]", row["FIT [%]"], fit, SHARE * (100.0 - fit))
        r_squared = 1.0 - (1.0 - fit / 100.0) ** 2
        yield Compared(f"{name}: R^2", row["R²"], r_squared, 2.0 * SHARE * (1.0 - r_squared))
        fit = fit_percent(measured - direct, modelled - direct)
        yield Compared(
            f"{name}: FIT of the deflection [%]", row["FIT of deflection [%]"], fit, SHARE * (100.0 - fit)
        )
        deviation = float(np.std(residuals))
        yield Compared(f"{name}: noise [m]", row["noise sd"], deviation, SHARE * deviation)
        printed = re.search(rf"{name}: the residuals look white \(p = ([\d.e-]+)", page.text)
        if printed:
            yield Compared(f"{name}: p of whiteness", printed[1], whiteness_p(residuals), 0.1)
    theory = summary.get("theory")
    if theory:
        printed = re.search(r"chi-squared ([\d.]+) over (\d+) modes, p = ([\d.e-]+)", page.text)
        assert printed is not None
        yield Compared("theory: p", printed[3], chi2.sf(theory["chi_squared"], int(printed[2])), 0.0)


def _of_modes(
    model: dict[str, Any], summary: dict[str, Any], page: _Tables, poles: list[dict[str, str]]
) -> Iterator[Compared]:
    covariance = np.array(model["covariance"])
    n, turn = len(model["damping_ratios"]), 2.0 * np.pi
    rate = 2 * n + 1
    table, budget = page.rows("mode", "f [Hz]", "95 % interval [Hz]"), page.rows("mode", "statistics [mHz]")
    shapes = page.rows("mode, output", "residue r", "|H| at ω")
    for k, (omega, zeta) in enumerate(
        zip(model["natural_frequencies_rad_s"], model["damping_ratios"], strict=True)
    ):
        row, file, parts, mode = table[str(k + 1)], poles[k], budget[str(k + 1)], f"mode {k + 1}: "
        pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
        clock = np.abs(covariance[[k, n + k], rate]) / np.sqrt(covariance[rate, rate])
        statistics = np.sqrt(np.diag(covariance)[[k, n + k]] - clock**2)
        temperature = float(file["frequency_sd_temperature_hz"] or 0.0)  # a person's word: it is in no data
        time_base = 0.0 if summary["apparatus"] == "simulated" else 50e-6 * omega / turn
        f, f_sd = (
            omega / turn,
            float(
                np.sqrt(
                    np.sum((np.array([clock[0], statistics[0]]) / turn) ** 2) + temperature**2 + time_base**2
                )
            ),
        )
        z_sd = float(np.hypot(clock[1], statistics[1]))
        yield Compared(f"{mode}pole, real", file["pole_real_rad_s"], pole.real, 1e-9)
        yield Compared(f"{mode}pole, imaginary", file["pole_imaginary_rad_s"], pole.imag, 1e-9)
        yield Compared(f"{mode}sd of f in poles.csv [Hz]", file["frequency_sd_hz"], f_sd, 1e-6 * f_sd)
        yield Compared(f"{mode}sd of zeta in poles.csv", file["damping_ratio_sd"], z_sd, 1e-6 * z_sd)
        for name, own in (("statistics", statistics[0]), ("clock", clock[0])):
            yield Compared(f"{mode}f, {name} [mHz]", parts[f"{name} [mHz]"], 1e3 * own / turn, 0.0)
        for title, value, sd, interval in (
            ("f [Hz]", f, f_sd, "95 % interval [Hz]"),
            ("ζ [%]", 100.0 * zeta, 100.0 * z_sd, "95 % interval [%]"),
        ):
            printed, _, printed_sd = row[title].partition(" ± ")
            yield Compared(f"{mode}{title}", printed, value, 0.0)
            yield Compared(f"{mode}sd of {title}", printed_sd, sd, 0.0)
            low, _, high = row[interval].partition(" to ")
            yield Compared(f"{mode}{title}, low", low, value - 1.96 * sd, 0.0)
            yield Compared(f"{mode}{title}, high", high, value + 1.96 * sd, 0.0)
        for j, name in enumerate(model["output_names"]):
            printed, _, printed_sd = shapes[f"{k + 1}, {name}"]["|H| at ω"].partition(" ± ")
            size = abs(response(model, parameters_of(model), j, omega))
            yield Compared(f"{mode}|H| of {name}", printed, size, 0.0)
            sd = magnitude_sd(model, j, omega)
            yield Compared(f"{mode}sd of |H| of {name}", printed_sd, sd, 1e-3 * sd)


def main() -> int:
    """Print every number twice, and say which differ."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.recomputed_report", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("bag", type=Path)
    parser.add_argument("folder", type=Path, help="of its report")
    arguments = parser.parse_args()
    found = list(compared(arguments.bag, arguments.folder))
    for own in found:
        print(
            f"{'' if own.agrees else 'DIFFERS '}{own.name}: {own.printed} on the page, {own.value:.7g} here"
        )
    differ = [own for own in found if not own.agrees]
    print(f"{len(found)} numbers, {len(differ)} differ")
    return 1 if differ else 0


if __name__ == "__main__":
    raise SystemExit(main())
