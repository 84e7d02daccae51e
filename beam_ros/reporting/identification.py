"""The report of an identified bag, with everything that goes beside it into one folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import IdentificationError, TimeRecord, models_of
from beam_ident.report.evidence import Trial
from beam_ident.report.identification import identification_page, poles_table
from beam_ident.report.page import Drawn, write_whole
from beam_ros.errors import UsageError
from beam_ros.interfaces.rig_parameters import IdentifierSettings
from beam_ros.offline.axis_bag import rig_file_of
from beam_ros.offline.identification import (
    Checked,
    Progress,
    fit,
    identification_of_bags,
    nothing_checked,
    write_models,
)
from beam_ros.offline.identification_summary import IdentificationOutcome
from beam_ros.offline.loading.experiment import Experiment
from beam_ros.offline.loading.options import FitOptions, paths
from beam_ros.process.folders import new_folder
from beam_ros.reporting.film import write_film
from beam_ros.reporting.printing import find_browser, print_pdf
from beam_ros.reporting.provenance import (
    provenance_of_bag,
    provenance_of_report,
    provenance_of_rig,
    provenance_of_software,
)
from beam_ros.rig.rig import Rig

_FIGURES = "figures"


@dataclass(frozen=True)
class Files:
    """What a report consists of.

    Attributes
    ----------
    report, model, poles : Path -- the page, the models as JSON, the poles as a table
    figures : tuple of Path -- the page's figures, each as a file of its own
    rig : Path or None -- the axis's mass and friction as a rig file, where they were identified
    film, pdf : Path or None
    """

    report: Path
    model: Path
    poles: Path
    figures: tuple[Path, ...]
    film: Path | None = None
    pdf: Path | None = None
    rig: Path | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the paths as texts, without what is not there."""
        named = {name: getattr(self, name) for name in ("report", "model", "poles", "film", "pdf", "rig")}
        return {name: str(path) for name, path in named.items() if path is not None}


def identify_told(
    settings: IdentifierSettings,
    rig: Rig | None = None,
    progress: Progress = lambda phrase, share: None,
    checked: Checked = nothing_checked,
    start_s: float | None = None,
    end_s: float | None = None,
) -> dict[str, Any]:
    """Identify and report what the parameters ``identifier.*`` name, as they say.

    Parameters
    ----------
    settings : IdentifierSettings
    rig : Rig, optional -- None: as the bags say
    progress : callable -- called with a phrase and the share done
    checked : callable -- called with every bag before anything is fitted, as by ``identification_of_bags``
    start_s, end_s : float, optional -- only what lies between these times after the first message of each bag [s]

    Returns
    -------
    dict -- what ``identification/result`` carries and ``--json`` prints, and where the report's files are

    Raises
    ------
    BagError, UsageError, ParameterFileError, IdentificationError
    """
    options = FitOptions.of(settings)
    bags = paths(settings.bag)
    if not bags:
        raise UsageError("no bag is named; expected the folder of a recorded one")
    folder = Path(settings.report) if settings.report else None
    if folder is not None:  # before the work, so that a wrong path costs nobody a long run
        new_folder(folder, settings.overwrite)
        if settings.pdf:
            find_browser()
    found = identification_of_bags(
        bags,
        rig=rig,
        options=options,
        validation=paths(settings.validate),
        start_s=start_s,
        end_s=end_s,
        checked=checked,
        temperature_k=settings.temperature_uncertainty or None,
        progress=progress,
    )
    if folder is None:
        return dict(found.content)
    files = report_identification(
        found,
        folder,
        overwrite=True,  # what must not be lost was refused above
        pdf=settings.pdf,
        operator=settings.operator,
        drawn=settings.figures,
        progress=progress,
    )
    return {**found.content, **files.to_dict()}


def report_identification(
    found: IdentificationOutcome,
    folder: Path,
    *,
    overwrite: bool = False,
    pdf: bool = False,
    operator: str = "",
    made: str = "",
    drawn: Drawn = "sheet",
    progress: Progress = lambda phrase, share: None,
) -> Files:
    """Write the report of an identification, its model, poles, figures and film.

    Parameters
    ----------
    found : IdentificationOutcome
    folder : Path
    overwrite : bool -- whether files that are there may be replaced
    pdf : bool -- whether a browser prints the page too
    operator : str -- who answers for the experiment
    drawn : "none", "sheet" or "all" -- which figures are drawn: those of the sheet to sign, or of the evidence too
    made : str -- the date that the report bears; empty: now
    progress : callable -- called with a phrase and the share done

    Raises
    ------
    UsageError
        The folder holds something that may not be overwritten, or a PDF is wanted where no browser is.
    """
    new_folder(folder, overwrite)
    progress("writing the report", 0.0)
    experiment = found.experiment
    film = folder / "film.mp4"
    shows = write_film(found, film, progress)
    links = [("The model, for computers", "model.json"), ("The poles, as a table", "poles.csv")]
    links += [(f"Film. {shows}", film.name)] if shows else []
    page = identification_page(
        f"Identification from {experiment.path.resolve().parent.name}/{experiment.path.name}",
        found.records,
        found.result,
        provenance=_provenance(found, operator, made),
        notes=[note for one in found.experiments for note in one.notes],
        gates=found.gates,
        simulated=found.simulated,
        validation=found.validation,
        theory=found.theory,
        sources=found.sources,
        trials=[trial_of(one, found.options, len(found.modes)) for one in found.experiments]
        if len(found.experiments) > 1
        else (),
        curves=found.curves,
        best_linear=found.best_linear,
        linearity=found.linearity,
        axis=found.axis,
        links=links,
        operator=operator,
        drawn=drawn,
    )
    report = page.write(folder / "report.html", overwrite)
    model = write_models(found, folder / "model.json")
    poles = folder / "poles.csv"
    write_whole(poles, poles_table(found.modes))
    drawings = []
    for name, svg in page.figures.items():
        drawings.append(folder / _FIGURES / f"{name}.svg")
        write_whole(drawings[-1], svg)
    rig_file = None
    if "rig_values" in found.content:
        rig_file = folder / "axis.yaml"
        write_whole(rig_file, rig_file_of(found.content["rig_values"]))
    printed = print_pdf(report, folder / "report.pdf") if pdf else None
    return Files(report, model, poles, tuple(drawings), film if shows else None, printed, rig_file)


def trial_of(experiment: Experiment, options: FitOptions, n_modes: int) -> Trial:
    """Identify one experiment by itself, to be compared with others.

    Raises
    ------
    IdentificationError
        Its data do not carry a model.
    """
    try:
        result = fit([experiment], replace(options, n_modes=n_modes))
    except IdentificationError as err:
        raise type(err)(f"{experiment.path}: {err}") from err
    return Trial(
        experiment.path.name, models_of(result)[0], deflection_of(experiment.record), str(experiment.path)
    )


def deflection_of(record: TimeRecord) -> float:
    """Return how far an output went from where the first input has it, or from its mean where that is no position."""
    drive = record.inputs[0]
    if drive.unit != record.outputs[0].unit:
        return max(float(np.nanmax(np.abs(o.values - np.nanmean(o.values)))) for o in record.outputs)
    signal = drive.signal()
    first, last = drive.span_s
    largest = 0.0
    for output in record.outputs:
        seen = output.is_valid & output.is_within(first, last)
        bent = output.values[seen] - signal(output.times_s[seen])
        largest = max(largest, float(np.max(np.abs(bent - np.median(bent)), initial=0.0)))
    return largest


def _provenance(found: IdentificationOutcome, operator: str, made: str) -> dict[str, Mapping[str, Any]]:
    asked = {"estimator": found.options.estimator, "structure": found.experiment.structure}
    if found.sources.temperature_k is not None:
        asked["temperature known to"] = f"{found.sources.temperature_k:g} K"
    groups: dict[str, Mapping[str, Any]] = {"Report": provenance_of_report(operator, asked, made)}
    for one in found.experiments:
        groups[f"Bag {one.path.name}"] = provenance_of_bag(one)
    for other, _ in found.unseen:
        groups[f"Bag of the validation {other.path.name}"] = provenance_of_bag(other)
    if found.experiment.rig is not None:
        groups["Rig"] = provenance_of_rig(found.experiment.rig)
    groups["Software"] = provenance_of_software()
    return groups


def format_files(content: Mapping[str, Any]) -> str:
    """Say where report and model were written."""
    names = ("report", "model", "poles", "film", "pdf", "rig")
    return "\n".join(f"{name:<8} {content[name]}" for name in names if content.get(name))
