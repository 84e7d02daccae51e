"""The report of an identification: one self-contained HTML file.

Style and figures are inside the file, so that it can be mailed, archived and opened
anywhere.  Every caption says what the figure means and where not to trust it.
"""

from __future__ import annotations

import html
import io
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from beam_ident import figures
from beam_ident.data.records import TimeRecord
from beam_ident.modal.identification_result import IdentificationResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = """
:root{--ink:#1f2937;--soft:#6b7280;--line:#e5e7eb;--accent:#c2410c;--paper:#ffffff}
*{box-sizing:border-box}
body{margin:0;background:#f3f4f6;color:var(--ink);
  font:15px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
main{max-width:60rem;margin:0 auto;padding:2.2rem 2.4rem 3rem;background:var(--paper);min-height:100vh}
h1{font-size:1.7rem;line-height:1.2;margin:0 0 .3rem}
h2{font-size:1.15rem;margin:2.4rem 0 .6rem;padding-top:.6rem;border-top:1px solid var(--line)}
.lead{color:var(--soft);margin:0 0 1rem}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums;font-size:.9rem}
th,td{text-align:right;padding:.35rem .6rem;border-bottom:1px solid var(--line)}
th{color:var(--soft);font-weight:600}th:first-child,td:first-child{text-align:left}
td.words{text-align:left}td:first-child{white-space:nowrap}
tr.chosen{background:#fff7ed;font-weight:600}
figure{margin:1rem 0 1.6rem}figure svg{width:100%;height:auto}
figcaption{color:var(--soft);font-size:.88rem;margin-top:.3rem}
.warning{border-left:4px solid var(--accent);background:#fff7ed;padding:.6rem .9rem;margin:.5rem 0}
.good{border-left:4px solid #0f766e;background:#f0fdfa;padding:.6rem .9rem;margin:.5rem 0}
.wide{overflow-x:auto}
@media (prefers-color-scheme:dark){body{background:#e5e7eb}}
@media print{body{background:#fff}main{padding:0}}
"""


def write_report(
    path: str | Path,
    title: str,
    record: TimeRecord,
    result: IdentificationResult,
    reference_modes: Sequence[tuple[str, float, float]] | None = None,
    provenance: Mapping[str, Any] | None = None,
    notes: Sequence[str] = (),
) -> Path:
    """Write the report of an identification as one HTML file.

    Parameters
    ----------
    path : path of the file; its folder is made where it is missing
    title : str
    record : TimeRecord -- what was measured
    result : IdentificationResult
    reference_modes : sequence of (name, omega [rad/s], zeta), optional
        Modes to compare with, from theory or from another identification.
    provenance : mapping, optional
        Where the data came from: bag, rig file, recipe, versions.
    notes : sequence of str, optional
        Paragraphs to print below the summary.

    Returns
    -------
    Path
        The file, which appears whole or not at all.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    text = _document(title, record, result, reference_modes, provenance or {}, notes)
    handle, temporary = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        os.chmod(temporary, 0o644)
        os.replace(temporary, target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return target


def _document(
    title: str,
    record: TimeRecord,
    result: IdentificationResult,
    reference_modes: Sequence[tuple[str, float, float]] | None,
    provenance: Mapping[str, Any],
    notes: Sequence[str],
) -> str:
    parts = [
        f"<h1>{_escape(title)}</h1>",
        f'<p class="lead">{_escape(_summary(record, result))}</p>',
        *(f"<p>{_escape(note)}</p>" for note in notes),
        _verdicts(result),
        "<h2>Modes</h2>",
        _modes_table(result, reference_modes),
        _figure(
            figures.pole_figure(result, reference_modes),
            "Damping ratio over natural frequency. The bars are 95 % intervals from the scatter of this one "
            "record; they do not include errors of geometry, of temperature or of a clock common to both "
            "signals, and a damping ratio holds only at the amplitude of this experiment.",
        ),
        "<h2>Outputs</h2>",
        _outputs_table(result),
        "<h2>Record</h2>",
        _figure(
            figures.time_figure(record),
            "What went into the estimation, as measured. Long records are thinned for drawing only, so that "
            "a fast oscillation can look like a slow one here.",
        ),
        "<h2>Fit</h2>",
        _figure(
            figures.fit_figure(result),
            "Deflection: each output less its direct part, offset and ramp, over the model's. A good "
            "agreement here is of the same data that the model was fitted to; only another record can "
            "validate it.",
        ),
        _figure(
            figures.spectrum_figure(result),
            "Spectra of the deflection and of what the model leaves over. Numbers mark the modes; a dotted "
            "line is a mode above half the outputs' rate, drawn at its alias. A peak in the residual means a "
            "mode or a disturbance that is not in the model. Where stamps are irregular the frequency axis "
            "is approximate.",
        ),
        _figure(
            figures.residual_figure(result),
            "Residuals and their autocorrelation. Of white residuals one lag in a hundred leaves the band by "
            "chance; more means coloured noise, which the stated intervals count, or dynamics that the model "
            "has not, which they do not count. Whiteness does not prove the model right: noise on the input "
            "leaves white residuals too.",
        ),
        "<h2>Frequency response of the model</h2>",
        _figure(
            figures.frequency_response_figure(result),
            "From the input to every output, with 95 % bands. Between modes and beyond the excited band "
            f"({result.band.low_hz:.3g} to {result.band.high_hz:.3g} Hz) the curve is an extrapolation: the "
            "bands assume that the structure of the model is right there.",
        ),
        "<h2>Order</h2>",
        _orders_table(result),
        "<h2>Parameters</h2>",
        _parameters_table(result),
        "<h2>Provenance</h2>" if provenance else "",
        _provenance_table(provenance),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{_escape(title)}</title><style>{_STYLE}</style></head><body><main>\n"
        + "\n".join(part for part in parts if part)
        + "\n</main></body></html>\n"
    )


def _escape(text: object) -> str:
    return html.escape(str(text), quote=True)


def _summary(record: TimeRecord, result: IdentificationResult) -> str:
    n = sum(len(output.times_s) for output in result.outputs)
    return (
        f"{result.model.n_modes} modes from {len(result.outputs)} outputs ({n} samples) of {record.name}, "
        f"structure {result.model.structure}, input {', '.join(result.model.input_names)}; "
        f"{'converged' if result.converged else 'not converged'} after {result.iterations} iterations "
        f"({result.reason})."
    )


def _verdicts(result: IdentificationResult) -> str:
    lines = [f'<p class="warning">{_escape(text)}</p>' for text in result.warnings]
    if not lines:
        lines = [
            '<p class="good">The fit converged, every mode passed its gates and the residuals look white.</p>'
        ]
    return "\n".join(lines)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], chosen: int | None = None) -> str:
    header = "".join(f"<th>{_escape(cell)}</th>" for cell in head)
    body = []
    for number, row in enumerate(rows):
        mark = ' class="chosen"' if number == chosen else ""
        body.append(
            f"<tr{mark}>"
            + "".join(f"<td>{_escape(cell).replace(' ± ', '&nbsp;±&nbsp;')}</td>" for cell in row)
            + "</tr>"
        )
    content = f"<thead><tr>{header}</tr></thead><tbody>{''.join(body)}</tbody>"
    return f'<div class="wide"><table>{content}</table></div>'


def with_uncertainty(value: float, sd: float) -> str:
    """Return a value and its standard deviation, rounded to two digits of the latter."""
    if not np.isfinite(sd) or sd <= 0.0:
        return f"{value:.6g}"
    if max(abs(value), sd) < 1e-4:
        power = int(np.floor(np.log10(max(abs(value), sd))))
        return f"({with_uncertainty(value / 10.0**power, sd / 10.0**power)})e{power:03d}"
    digits = _decimals(sd)
    return f"{value:.{digits}f} ± {sd:.{digits}f}"


def _decimals(sd: float, least: int = 0) -> int:
    """Return how many decimals show two digits of a standard deviation."""
    if not np.isfinite(sd) or sd <= 0.0:
        return max(least, 6)
    return int(np.clip(1 - np.floor(np.log10(sd)), least, 12))


def nearest_mode(natural_frequencies: Any, omega: float) -> int | None:
    """Return the index of the frequency within 25 % of ``omega`` that is nearest, or None."""
    distance = np.abs(np.log(np.asarray(natural_frequencies) / omega))
    best = int(np.argmin(distance))
    return best if distance[best] < np.log(1.25) else None


def _modes_table(result: IdentificationResult, reference: Sequence[tuple[str, float, float]] | None) -> str:
    model = result.model
    head = ["mode", "f [Hz]", "damping ratio [%]"]
    if reference:
        head += ["reference f [Hz]", "difference [%]", "z", "reference damping [%]", "z"]
    rows = []
    names = {
        nearest_mode(model.natural_frequencies, omega): (name, omega, zeta)
        for name, omega, zeta in reference or ()
    }
    for i in range(model.n_modes):
        sd_omega, sd_zeta = float(model.natural_frequency_sd[i]), float(model.damping_ratio_sd[i])
        omega, zeta = float(model.natural_frequencies[i]), float(model.damping_ratios[i])
        row = [
            str(i + 1),
            with_uncertainty(omega / (2 * np.pi), sd_omega / (2 * np.pi)),
            with_uncertainty(100 * zeta, 100 * sd_zeta),
        ]
        if reference and i in names:
            name, omega_0, zeta_0 = names[i]
            row[0] = f"{i + 1} ({name})"
            row += [
                f"{omega_0 / (2 * np.pi):.{_decimals(sd_omega / (2 * np.pi), 3)}f}",
                f"{100 * (omega / omega_0 - 1):+.3g}",
                f"{(omega - omega_0) / max(sd_omega, 1e-300):+.2f}",
                f"{100 * zeta_0:.4g}",
                f"{(zeta - zeta_0) / max(sd_zeta, 1e-300):+.2f}",
            ]
        elif reference:
            row += ["–"] * 5
        rows.append(row)
    text = _table(head, rows)
    if reference:
        text += (
            "<p class='lead'>z is the difference over the statistical standard deviation alone: a theory "
            "with an uncertain length, thickness or temperature may differ by many of them and still be "
            "right.</p>"
        )
    return text


def _outputs_table(result: IdentificationResult) -> str:
    head = [
        "output",
        "samples",
        "FIT [%]",
        "R²",
        "FIT of deflection [%]",
        "R² of deflection",
        "noise sd",
        "residuals",
    ]
    rows = []
    for o in result.outputs:
        rows.append(
            [
                o.name,
                str(len(o.times_s)),
                f"{o.scores.fit_percent:.3f}",
                f"{o.scores.r_squared:.7f}",
                f"{o.deflection_scores.fit_percent:.3f}",
                f"{o.deflection_scores.r_squared:.6f}",
                f"{o.noise_sd:.3g} {o.unit}",
                "white" if o.whiteness.is_white else "not white",
            ]
        )
    return _table(head, rows) + "".join(
        f"<p class='lead'>{_escape(o.name)}: {_escape(o.whiteness.verdict)}.</p>" for o in result.outputs
    )


def _orders_table(result: IdentificationResult) -> str:
    head = ["modes", "parameters", "BIC", "AIC", "worst R²", "worst FIT [%]", "condition", "verdict"]
    least = min(entry.bic for entry in result.orders)
    rows = []
    for e in result.orders:
        rows.append(
            [
                str(e.n_modes),
                str(e.n_parameters),
                f"{e.bic - least:.1f}",
                f"{e.aic - least:.1f}",
                f"{e.r_squared:.6f}",
                f"{e.worst_fit_percent:.2f}",
                f"{e.condition:.3g}",
                "chosen" if e.is_chosen else (e.refused_because or "passed"),
            ]
        )
    chosen = next((i for i, e in enumerate(result.orders) if e.is_chosen), None)
    return (
        _table(head, rows, chosen)
        + "<p class='lead'>BIC and AIC are given above the lowest BIC; lower is better. A number of modes that "
        "is listed twice was tried with its last mode at two frequencies.</p>"
    )


def _parameters_table(result: IdentificationResult) -> str:
    model = result.model
    rows = [
        [name, with_uncertainty(float(value), float(sd)) if sd != 0.0 else f"{value:.6g}, held"]
        for name, value, sd in zip(
            model.parameter_names, model.parameters, model.standard_deviations, strict=True
        )
    ]
    return _table(["parameter (SI)", "estimate ± standard deviation"], rows)


def _provenance_table(provenance: Mapping[str, Any]) -> str:
    if not provenance:
        return ""
    rows = "".join(
        f'<tr><td>{_escape(key)}</td><td class="words">{_escape(value)}</td></tr>'
        for key, value in provenance.items()
    )
    return f'<div class="wide"><table><tbody>{rows}</tbody></table></div>'


def _figure(figure: Figure, caption: str) -> str:
    from matplotlib import rc_context

    buffer = io.StringIO()
    with rc_context({"svg.hashsalt": "beam_ident", "svg.fonttype": "path", "path.simplify": True}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    return f"<figure>{svg}<figcaption>{_escape(caption)}</figcaption></figure>"
