"""The model's equation with every symbol: its meaning, its unit, and the value that was found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from beam_ident.data.records import TimeRecord
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure
from beam_ident.quantities import with_uncertainty
from beam_ident.report.page import Page
from beam_ident.subspace.model import SubspaceModel
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.multi_input_model import MultiInputModel

_MEANINGS = {
    "base_motion": "position of the moved base",
    "velocity": "velocity of the moved base",
    "acceleration": "acceleration of the moved base",
    "force": "force on the free base",
    "receptance": "force",
    "mobility": "force",
    "accelerance": "force",
}


def add_equation(page: Page, models: Sequence[Any], record: TimeRecord) -> None:
    """Add the equation of a result's models, and the table of its symbols with their values.

    Parameters
    ----------
    page : Page
    models : sequence of models of one kind
    record : TimeRecord -- for the units
    """
    first = models[0]
    if isinstance(first, ModalModel):
        _add_modal(page, first, record)
    elif isinstance(first, SubspaceModel):
        _add_equation_of_fraction(page, has_delay=False)
        _add_symbols(page, _of_subspace(first, record))
    elif isinstance(first, TransferFunctionModel | MultiInputModel):
        _add_equation_of_fraction(page, has_delay=True)
        rows = []
        for model in models:
            several = isinstance(model, MultiInputModel)
            for path in [model.path(name) for name in model.input_names] if several else [model]:
                rows += _of_transfer_function(path, record)
        _add_symbols(page, rows)
    else:
        page.paragraph(f"The model is a {type(first).__name__}; its numbers stand in model.json.")


def _add_modal(page: Page, model: ModalModel, record: TimeRecord) -> None:
    structure = ModalStructure(model.structure)
    d = structure.differentiations
    drive = _sub("U", "k") if model.further_inputs else "<mi>U</mi>"
    of = "j k" if model.further_inputs else "j"
    direct = _sub("c", of) + _power(d - 2) if structure.has_direct else ""
    sign = "<mo>−</mo>" if structure.sign < 0 else "<mo>+</mo>" if direct else ""
    total = (
        "<munderover><mo>∑</mo><mrow><mi>i</mi><mo>=</mo><mn>1</mn></mrow><mi>n</mi></munderover>"
        f"<mfrac>{_sub('r', of + ' i')}<mrow><msup><mi>s</mi><mn>2</mn></msup><mo>+</mo><mn>2</mn>"
        f"{_sub('ζ', 'i')}{_sub('ω', 'i')}<mi>s</mi><mo>+</mo><msubsup><mi>ω</mi><mi>i</mi><mn>2</mn></msubsup>"
        "</mrow></mfrac>"
    )
    over_inputs = "<munder><mo>∑</mo><mi>k</mi></munder>" if model.further_inputs else ""
    page.equation(
        f"{_sub('Y', 'j')}<mo>(</mo><mi>s</mi><mo>)</mo><mo>=</mo>{over_inputs}<mrow><mo>{{</mo>{direct}{sign}"
        f"{_power(d)}<mrow><mo>[</mo>{total}<mo>+</mo>{_sub('R', of)}<mo>]</mo></mrow><mo>}}</mo></mrow>{drive}"
        "<mo>(</mo><mi>s</mi><mo>)</mo>",
        "The Laplace transform of output j is that of the input times the sum of a direct part, one second-order "
        "term for each mode, and a static rest.",
    )
    page.equation(
        f"{_sub('y', 'j')}<mo>(</mo><msub><mi>t</mi><mi>k</mi></msub><mo>)</mo><mo>=</mo>{_sub('y', 'j')}"
        "<mo>(</mo><mi>m</mi><mo>+</mo><mo>(</mo><mn>1</mn><mo>−</mo><mi>ε</mi><mo>)</mo><mo>(</mo>"
        "<msub><mi>t</mi><mi>k</mi></msub><mo>−</mo><mi>T</mi><mo>−</mo><mi>m</mi><mo>)</mo><mo>)</mo><mo>+</mo>"
        f"{_sub('a', 'j')}<mo>+</mo>{_sub('b', 'j')}<msub><mi>t</mi><mi>k</mi></msub><mo>+</mo>{_sub('e', 'j')}",
        "A sample of output j is the output at the instant that its stamp means, which is earlier by the latency and "
        "stretched about the middle of the record by the clock rate, with an offset, a drift and noise.",
    )
    page.paragraph(
        f"The input U is the {_MEANINGS[model.structure]} ({', '.join(model.input_names)}), s the Laplace variable; "
        "a and b are the offset and the drift of an output in each record, e is its noise, and m the middle of the "
        "record, between its first and its last stamp. Where a sensor is exposed for a while, its sample is the mean "
        "over that. The modes may already move when a record begins. Everything is in SI units."
    )
    units = _units(record)
    rows: list[list[str]] = []
    values = dict(
        zip(model.parameter_names, zip(model.parameters, model.standard_deviations, strict=True), strict=True)
    )
    for name, (value, sd) in values.items():
        symbol, meaning, unit = _modal_symbol(name, model, d, units)
        text = with_uncertainty(float(value), float(sd)) if sd != 0.0 else f"{value:.6g}, held"
        rows.append([symbol, meaning, unit, text])
    for j, name in enumerate(model.output_names):
        noise = float(model.noise_sd[j])
        text = f"{noise:.3g}" if noise == noise else "–"
        rows.append([f"σ[{name}]", "standard deviation of the noise e", units.get(name, "m"), text])
    _add_symbols(page, rows)


def _modal_symbol(name: str, model: ModalModel, d: int, units: dict[str, str]) -> tuple[str, str, str]:
    """Return symbol, meaning and unit of a parameter by its name in the model."""
    kind, _, rest = name.partition("[")
    if kind == "latency":
        return "T", "how late the outputs' stamps are", "s"
    if kind == "clock_rate":
        return "ε", "how much faster the outputs' clock runs than the input's", "1"
    number = kind.rpartition("_")[2]
    if kind.startswith("omega"):
        return f"ω{number}", f"natural frequency of mode {number}", "rad/s"
    if kind.startswith("zeta"):
        return f"ζ{number}", f"damping ratio of mode {number}", "1"
    output, _, drive = rest.rstrip("]").partition(", ")
    ratio = _over(units.get(output, "m"), units.get(drive or model.input_name, ""))
    if kind == "R":
        return f"R[{rest}", f"static rest of the modes left out, at {output}", _times_seconds(ratio, d)
    if kind == "c":
        return f"c[{rest}", f"how {output} follows the input directly", _times_seconds(ratio, d - 2)
    return f"r{number}[{rest}", f"share of mode {number} at {output}", _times_seconds(ratio, d - 2)


def _add_equation_of_fraction(page: Page, has_delay: bool) -> None:
    delay = "<msup><mi>e</mi><mrow><mo>−</mo><mi>s</mi><mi>T</mi></mrow></msup>" if has_delay else ""
    page.equation(
        "<mi>Y</mi><mo>(</mo><mi>s</mi><mo>)</mo><mo>=</mo><mfrac>"
        f"<mrow>{_sub('b', '0')}<msup><mi>s</mi><mi>m</mi></msup><mo>+</mo><mo>…</mo><mo>+</mo>"
        f"{_sub('b', 'm')}</mrow>"
        f"<mrow><msup><mi>s</mi><mi>n</mi></msup><mo>+</mo>{_sub('a', '1')}<msup><mi>s</mi><mrow><mi>n</mi><mo>−</mo>"
        f"<mn>1</mn></mrow></msup><mo>+</mo><mo>…</mo><mo>+</mo>{_sub('a', 'n')}</mrow></mfrac>{delay}"
        "<mi>U</mi><mo>(</mo><mi>s</mi><mo>)</mo><mo>+</mo><mi>E</mi><mo>(</mo><mi>s</mi><mo>)</mo>",
        "The Laplace transform of the output is that of the input times a polynomial over another"
        f"{', delayed,' if has_delay else ''} plus noise.",
    )
    page.paragraph(
        "s is the Laplace variable, Y the output, U the input, E the noise; a record may carry an offset, a drift "
        "and motion that was there at its beginning. Everything is in SI units."
    )


def _of_transfer_function(model: TransferFunctionModel, record: TimeRecord) -> list[list[str]]:
    units = _units(record)
    ratio = _over(units.get(model.output_name, ""), units.get(model.input_name, ""))
    n, m = model.n_poles, len(model.numerator) - 1
    where = f"[{model.output_name}, {model.input_name}]"
    rows = []
    sds = model.standard_deviations
    for k in range(n):
        value, sd = float(model.denominator[k + 1]), float(sds[k])
        rows.append(
            [
                f"a{k + 1}{where}",
                f"denominator, at s^{n - k - 1}",
                _times_seconds("1", -k - 1),
                _or_held(value, sd),
            ]
        )
    for k in range(m + 1):
        value, sd = float(model.numerator[k]), float(sds[n + k])
        unit = _times_seconds(ratio, m - k - n)
        rows.append([f"b{k}{where}", f"numerator, at s^{m - k}", unit, _or_held(value, sd)])
    rows.append([f"T{where}", "delay", "s", _or_held(model.delay, float(sds[-1]))])
    rows.append(
        [
            f"σ{where}",
            "standard deviation of the noise",
            units.get(model.output_name, ""),
            f"{model.noise_sd:.3g}",
        ]
    )
    return rows


def _of_subspace(model: SubspaceModel, record: TimeRecord) -> list[list[str]]:
    units, n = _units(record), len(model.poles)
    rows = [
        [
            f"a{k + 1}",
            f"denominator, at s^{n - k - 1}",
            _times_seconds("1", -k - 1),
            f"{model.denominator[k + 1]:.6g}",
        ]
        for k in range(n)
    ]
    for j, name in enumerate(model.output_names):
        for i, drive in enumerate(model.input_names):
            ratio = _over(units.get(name, ""), units.get(drive, ""))
            rows += [
                [
                    f"b{k}[{name}, {drive}]",
                    f"numerator, at s^{n - k}",
                    _times_seconds(ratio, -k),
                    f"{model.numerators[j, i, k]:.6g}",
                ]
                for k in range(n + 1)
            ]
    return rows


def _add_symbols(page: Page, rows: Sequence[Sequence[str]]) -> None:
    page.table(
        ["symbol", "meaning", "unit", "value"],
        rows,
        "Every symbol of the equation, with its estimate and standard deviation from the scatter of the samples.",
    )


def _or_held(value: float, sd: float) -> str:
    return with_uncertainty(value, sd) if sd != 0.0 else f"{value:.6g}, held"


def _units(record: TimeRecord) -> dict[str, str]:
    of_inputs = {drive.name: drive.unit for drive in record.inputs}
    return of_inputs | {output.name: output.unit for output in record.outputs}


def _over(unit: str, other: str) -> str:
    if unit == other or not other:
        return unit if unit != other else "1"
    return f"{unit}/({other})" if any(sign in other for sign in "/^ ") else f"{unit}/{other}"


def _times_seconds(unit: str, power: int) -> str:
    """Return a unit times seconds to a power."""
    if power == 0:
        return unit
    seconds = "s" if abs(power) == 1 else f"s^{abs(power)}"
    if power > 0:
        return seconds if unit == "1" else f"{unit} {seconds}"
    return f"1/{seconds}" if unit == "1" else f"{unit}/{seconds}"


def _sub(symbol: str, index: str) -> str:
    parts = "".join(f"<mi>{part}</mi>" for part in index.split())
    return f"<msub><mi>{symbol}</mi><mrow>{parts}</mrow></msub>"


def _power(power: int) -> str:
    """Return s to a power as MathML; nothing for none."""
    if power == 0:
        return ""
    return "<mi>s</mi>" if power == 1 else f"<msup><mi>s</mi><mn>{power}</mn></msup>".replace("-", "−")
