"""The same modes through all three domains: time record, frequency record and free decay give the same verdicts."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, chirp, cont2discrete, lfilter, sosfilt

from beam_ident import (
    EstimationError,
    FrequencyRecord,
    InputSignal,
    LogChirp,
    ModalStructure,
    OutputSignal,
    Prior,
    TimeRecord,
    fit_free_decay,
    fit_frequency_modes,
    identify,
)
from beam_ident.data.bandwidth import Band
from tests.beam_ident.truth import OMEGAS, beam_record

PLAIN = ModalStructure(
    "receptance", has_residual=False, has_offset=False, has_ramp=False, has_free_response=False
)
TICK_S = 0.005
FINE = (5.0, 0.02, 1.0)  # hertz, damping ratio, static deflection (or amplitude of a decay)
Mode = tuple[float, float, float]
Fit = Callable[[int | None], Any]


def time_record(second: Mode, noise: float, seed: int) -> Fit:
    """Return `identify` on eight seconds under a swept force held between ticks, 1 to 20 Hz."""
    ticks = chirp(TICK_S * np.arange(1602), 1.0, TICK_S * 1601, 20.0)
    clean = np.zeros(1602)
    for hertz, zeta, static in (FINE, second):
        omega = 2.0 * np.pi * hertz
        plant = ([static * omega**2], [1.0, 2.0 * zeta * omega, omega**2])
        numerator, denominator, _ = cont2discrete(plant, TICK_S, "zoh")
        clean += lfilter(np.squeeze(numerator), denominator, ticks)
    values = clean[:-1:2] + noise * np.random.default_rng(seed).standard_normal(801)
    drive = InputSignal("f", "N", (0.0, TICK_S), ticks, "zoh")
    record = TimeRecord((drive,), (OutputSignal("y", "m", 2 * TICK_S * np.arange(801), values),))
    return lambda n_modes: identify(record, PLAIN, n_modes, Prior(), Prior(), max_modes=3)


def frequency_record(second: Mode, noise: float, seed: int) -> Fit:
    """Return `fit_frequency_modes` on lines from 1 to 20 Hz, 0.25 Hz apart, their noise known."""
    hertzes = np.arange(4, 81) / 4.0
    s, rng = 2j * np.pi * hertzes, np.random.default_rng(seed)
    response = np.zeros(len(s), dtype=complex)
    for hertz, zeta, static in (FINE, second):
        omega = 2.0 * np.pi * hertz
        response += static * omega**2 / (s**2 + 2.0 * zeta * omega * s + omega**2)
    response += noise / np.sqrt(2.0) * (rng.standard_normal(len(s)) + 1j * rng.standard_normal(len(s)))
    variance = np.full((len(s), 1, 1), noise**2)
    record = FrequencyRecord(2.0 * np.pi * hertzes, response[:, None, None], variance, ("y",), ("f",))
    return lambda n_modes: fit_frequency_modes(record, PLAIN, n_modes, max_modes=3)


def free_decay(second: Mode, noise: float, seed: int) -> Fit:
    """Return `fit_free_decay` on two seconds of 60 samples each."""
    times = np.arange(120) / 60.0
    values = noise * np.random.default_rng(seed).standard_normal(120)
    for hertz, zeta, amplitude in (FINE, second):
        pole = 2.0 * np.pi * hertz * complex(-zeta, np.sqrt(1.0 - zeta**2))
        values += amplitude * np.exp(pole * times).real
    return lambda n_modes: fit_free_decay(OutputSignal("y", "m", times, values), n_modes, max_modes=3)


DOMAINS = (time_record, frequency_record, free_decay)


@dataclass(frozen=True)
class Case:
    """A second mode that deserves a verdict: what says so, and each domain's mode, noise and seed."""

    says: str
    domains: tuple[tuple[Mode, float, int], ...]


CASES = {
    "fine": Case("", tuple(((12.1, 0.01, 0.3), 0.01, 0) for _ in DOMAINS)),
    # Tens of thousands of cycles to ring down, of which a record shows a hundred and a line of 0.25 Hz nothing.
    "unknown damping": Case(
        "the damping ratio at # Hz is # +- #",
        (((16.1, 2e-5, 0.05), 0.1, 1), ((16.1, 2e-5, 0.05), 0.2, 3), ((16.1, 2e-5, 0.3), 0.1, 1)),
    ),
    # Above what is excited; of the decay, less than half a cycle.
    "outside the band": Case(
        "the frequency ran out of the excited band, to # Hz",
        (((40.0, 0.01, 0.3), 0.001, 1), ((40.0, 0.01, 0.3), 0.001, 1), ((0.2, 0.01, 1.0), 0.001, 1)),
    ),
    "residues within their uncertainty": Case(
        "the mode at # Hz does not stand out of its uncertainty at any output",
        (((12.1, 0.01, 0.005), 0.1, 2), ((12.1, 0.01, 0.006), 0.1, 2), ((12.1, 0.01, 0.15), 0.2, 2)),
    ),
    # What drives itself grows, which no damping ratio of the model can follow.
    "damping at its bound": Case(
        "the damping ratio at # Hz ran to zero",
        (((16.1, -3e-4, 0.05), 0.01, 0), ((16.1, -3e-4, 0.05), 0.01, 0), ((16.1, -3e-4, 0.3), 0.01, 0)),
    ),
}


def words(text: str) -> str:
    """Return a verdict without its numbers."""
    return re.sub(r"\d+(\.\d+)?(e[+-]?\d+)?", "#", text)


@pytest.mark.first_case
@pytest.mark.parametrize("domain", range(3), ids=[make.__name__ for make in DOMAINS])
@pytest.mark.parametrize("case", CASES)
def test_the_same_cases_through_all_three_domains_give_the_same_verdicts(case, domain):
    says = CASES[case].says
    fit = DOMAINS[domain](*CASES[case].domains[domain])
    free, given = fit(None), fit(2)
    refused = {words(entry.refused_because) for entry in free.orders if entry.n_modes == 2}
    (chosen,) = [entry.n_modes for entry in free.orders if entry.is_chosen]
    warned = [words(said) for said in given.warnings if said.startswith("Mode ")]
    assert chosen == (1 if says else 2)
    assert says in refused
    assert warned == ([f"Mode #: {says}."] if says else [])
    # An order that is given is kept, and the table says what speaks against it.
    (kept,) = [entry for entry in given.orders if entry.is_chosen]
    assert kept.n_modes == 2
    assert words(kept.refused_because) in (says, "the fit did not converge: stopped after # iterations")


@pytest.mark.parametrize("make", DOMAINS)
def test_noise_alone_is_refused_with_the_same_words(make):
    fit = make((12.1, 0.01, 0.1), 100.0, 0)  # drowns the first mode too
    with pytest.raises(EstimationError, match=r"no mode between .* Hz stands out of the noise"):
        fit(None)


@pytest.mark.slow
def test_a_mode_that_the_noise_as_it_is_leaves_in_doubt_is_refused():
    """Four time constants under noise, as of a hydraulic actuator: with equal weights one mode is believed."""
    rng, n, step = np.random.default_rng(2), 300, 0.01
    drive = sosfilt(butter(2, 0.1, output="sos"), rng.standard_normal(n))
    force = 3e-3 * rng.standard_normal(n)
    for constant, gain in ((0.03, 1.0), (0.1, -0.8), (0.4, 1.5), (2.0, 1.0)):
        decay = np.exp(-step / constant)
        force += gain * lfilter([1.0 - decay], [1.0, -decay], drive)
    stamps = step * np.arange(n)
    record = TimeRecord(
        (InputSignal("valve", "V", stamps, drive, "zoh"),), (OutputSignal("force", "N", stamps, force),)
    )
    with pytest.raises(
        EstimationError, match=r"stands out of the noise \(weighed by it as it is, .* known to"
    ):
        identify(record, "force")


def _swept(outputs: Callable[[np.ndarray], np.ndarray]) -> TimeRecord:
    """Return a record of two outputs, 4 um of noise, under a swept force that is held between ticks."""
    ticks = chirp(TICK_S * np.arange(2002), 3.0, TICK_S * 2001, 8.0)
    ticks[1600:] = 0.0
    seen = outputs(ticks) + 4e-6 * np.random.default_rng(0).standard_normal((2002, 2))
    drive = InputSignal("f", "N", (0.0, TICK_S), ticks, "zoh")
    stamps = TICK_S * np.arange(2002)
    return TimeRecord(
        (drive,), tuple(OutputSignal(name, "m", stamps, seen[:, k]) for k, name in enumerate("ab"))
    )


@pytest.mark.slow
def test_one_mode_under_drag_that_passes_for_several_is_named() -> None:
    def dragged(ticks: np.ndarray) -> np.ndarray:
        omega, moved = 2.0 * np.pi * 5.0, np.zeros((len(ticks), 2))
        here, speed, n = 0.0, 0.0, 20
        for k, force in enumerate(ticks):
            moved[k] = here * np.array([1.0, 0.6])
            for _ in range(n):
                drag = 2.0 * 0.01 * omega * speed + 8.0 * abs(speed) * speed
                speed += TICK_S / n * (3.0 * force - drag - omega**2 * here)
                here += TICK_S / n * speed
        return moved

    result = identify(_swept(dragged), PLAIN, 2, Prior(), Prior())
    assert any("Modes 1, 2 overlap and move the outputs alike" in said for said in result.warnings)
    assert any("n_modes=1" in said for said in result.warnings)


def test_two_close_modes_of_different_shapes_are_believed() -> None:
    def coupled(ticks: np.ndarray) -> np.ndarray:
        moved = np.zeros((len(ticks), 2))
        for hertz, shape in ((5.0, [1.0, 0.6]), (5.05, [0.6, -1.0])):
            omega = 2.0 * np.pi * hertz
            numerator, denominator, _ = cont2discrete(([1.0], [1.0, 0.02 * omega, omega**2]), TICK_S, "zoh")
            moved += np.outer(lfilter(np.squeeze(numerator), denominator, ticks), shape)
        return moved

    result = identify(_swept(coupled), PLAIN, None, Prior(), Prior())
    assert result.model.n_modes == 2
    assert not any("overlap" in said for said in result.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "words"),
    [(-1.0, ["sign"]), (1e3, ["millimetres"]), (-1e3, ["sign", "millimetres"]), (1.1, [])],
)
def test_a_sign_or_a_unit_that_is_mistaken_is_named(factor, words):
    record = beam_record(6)
    mistaken = record.outputs[-1]
    outputs = [
        OutputSignal(o.name, o.unit, o.times_s, o.values * (factor if o is mistaken else 1.0), o.exposure_s)
        for o in record.outputs
    ]
    said = " ".join(identify(TimeRecord(record.inputs, tuple(outputs)), n_modes=3).warnings)
    assert (f"Output {mistaken.name} follows" in said) == bool(words)
    assert all(word in said for word in words)


@pytest.mark.parametrize(
    ("hertz", "is_refused"), [(101.0, True), (95.0, False), (79.5, False), (0.4, True), (0.6, False)]
)
def test_beyond_half_the_frame_rate_a_mode_stands_where_the_input_has_power(hertz, is_refused):
    # A slow wander of 1 Hz looks like 101 Hz at 100 frames a second; the chirp ends at 95 Hz.
    band = Band(1.0, 95.5, True, unfolded_hz=50.0)
    assert (not band.reach_hz[0] < hertz < band.reach_hz[1]) == is_refused


@pytest.mark.slow
def test_a_wander_neither_is_a_mode_nor_hides_one():
    record = beam_record(8, LogChirp(end_frequency=95.0))
    wander = 10e-6 * np.cos(2.0 * np.pi * 1.02 * record.outputs[0].times_s)
    outputs = tuple(
        OutputSignal(o.name, o.unit, o.times_s, o.values + wander, o.exposure_s) for o in record.outputs
    )
    found = identify(TimeRecord(record.inputs, outputs)).model
    np.testing.assert_allclose(found.natural_frequencies, OMEGAS, rtol=1e-3)
