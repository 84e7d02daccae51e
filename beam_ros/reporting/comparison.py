"""Bags and stored models side by side, for ``beam compare``."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from beam_ident import models_of
from beam_ident.errors import ModelFormatError
from beam_ident.report.comparison import Difference, comparison_page, differences, format_comparison
from beam_ident.report.evidence import Trial, mode_rows
from beam_ident.stored_results import restore
from beam_ros.errors import UsageError
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.loading.options import FitOptions
from beam_ros.process.folders import new_folder
from beam_ros.process.strict_json import strict_json
from beam_ros.reporting.identification import deflection_of
from beam_ros.reporting.provenance import checksums, provenance_of_report, provenance_of_software

_MODEL = "model.json"
_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Comparison:
    """Models side by side.

    Attributes
    ----------
    trials : tuple of Trial -- what is compared, the first being what the others are compared with
    found : tuple of Difference
    """

    trials: tuple[Trial, ...]
    found: tuple[Difference, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison in plain numbers."""
        return {
            "schema": 1,
            "models": [
                {
                    "name": trial.name,
                    "source": trial.source,
                    "deflection_m": trial.amplitude,
                    "modes": [
                        {
                            "frequency_hz": mode.omega / _TURN,
                            "frequency_sd_hz": mode.omega_sd / _TURN,
                            "damping_ratio": mode.zeta,
                            "damping_ratio_sd": mode.zeta_sd,
                        }
                        for mode in mode_rows((trial.model,))
                    ],
                }
                for trial in self.trials
            ],
            "differences": [asdict(one) for one in self.found],
        }

    def table(self) -> str:
        """Return the comparison as a table for a terminal."""
        return format_comparison(self.trials, self.found)


def compare(
    paths: Sequence[Path],
    *,
    estimator: str = "modal",
    n_modes: int | None = None,
    progress: Callable[[str, float], None] = lambda phrase, share: None,
) -> Comparison:
    """Compare bags and stored models with the first of them.

    Parameters
    ----------
    paths : sequence of Path
        Bags, which are identified; files that ``beam identify`` wrote as ``model.json``, or folders that hold one.
    estimator : str -- for the bags
    n_modes : int, optional -- for the bags; None: from the data
    progress : callable -- called with a phrase and the share done

    Raises
    ------
    BagError, UsageError, IdentificationError
        A bag or a model cannot be read or identified, or there are fewer than two.
    """
    if len(paths) < 2:
        raise UsageError(f"{len(paths)} bag or model is given; expected at least two: beam compare A B")
    trials: list[Trial] = []
    for number, (path, name) in enumerate(zip(paths, _names(paths), strict=True)):
        progress(f"reading {path}", number / len(paths))
        trials += _trials(path, name, estimator, n_modes)
    return Comparison(tuple(trials), differences(trials))


def _names(paths: Sequence[Path]) -> list[str]:
    """Return a short name for every path, longer ones where two would be the same."""
    named = [path.parent if path.name == _MODEL else path for path in (path.resolve() for path in paths)]
    short = [path.name for path in named]
    longer = [f"{path.parent.name}/{path.name}" for path in named]
    names = [one if short.count(one) == 1 else two for one, two in zip(short, longer, strict=True)]
    return [name if names.count(name) == 1 else f"{name} ({k})" for k, name in enumerate(names, 1)]


def _trials(path: Path, name: str, estimator: str, n_modes: int | None) -> list[Trial]:
    file = path / _MODEL if (path / _MODEL).is_file() else path
    if file.suffix == ".json":
        models = stored_models(file)
        return [Trial(_named(name, models, model), model, source=str(file)) for model in models]
    outcome = identification_of_bags(path, options=FitOptions(estimator=estimator, n_modes=n_modes))
    models = list(models_of(outcome.result))
    deflection = deflection_of(outcome.experiment.record)
    return [Trial(_named(name, models, model), model, deflection, str(path)) for model in models]


def _named(name: str, models: Sequence[Any], model: Any) -> str:
    return f"{name} {model.output_name}" if len(models) > 1 else name


def stored_model_file(path: Path) -> Path:
    """Return the ``model.json`` of a folder, or the file that is given."""
    return path / _MODEL if (path / _MODEL).is_file() else path


def stored_models(file: Path) -> list[Any]:
    """Return the models of a ``model.json``, or of the folder that holds one.

    Raises
    ------
    UsageError
        The file cannot be read, or holds no model.
    """
    file = stored_model_file(file)
    if not file.exists():
        raise UsageError(
            f"{file}: is not there; expected a bag, or the model.json that `beam identify` wrote"
        )
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as err:
        raise UsageError(
            f"{file}: cannot be read as JSON ({err}); expected a bag, or the model.json that `beam identify` wrote"
        ) from err
    if not isinstance(document, Mapping):
        raise UsageError(f"{file}: holds no model; expected the model.json that `beam identify` wrote")
    stored = document.get("models") or [document.get("model", document)]
    try:
        return [restore(one) for one in stored]
    except ModelFormatError as err:
        raise UsageError(f"{file}: {err}; give the model.json that `beam identify` wrote, or a bag") from err


def write_comparison(
    comparison: Comparison, folder: Path, overwrite: bool = False, operator: str = ""
) -> Path:
    """Write the page of a comparison, and the numbers as JSON beside it.

    Raises
    ------
    UsageError
        The folder holds something that may not be overwritten.
    """
    new_folder(folder, overwrite)
    sources: dict[str, Mapping[str, Any]] = {
        "Comparison": provenance_of_report(operator, {"compared with": comparison.trials[0].name})
    }
    for source in dict.fromkeys(trial.source for trial in comparison.trials):
        sums = {f"SHA-256 of {name}": digest for name, digest in checksums(Path(source)).items()}
        sources[f"Source {source}"] = sums
    sources["Software"] = provenance_of_software()
    names = ", ".join(trial.name for trial in comparison.trials)
    page = comparison_page(f"Comparison of {names}", comparison.trials, sources)
    (folder / "comparison.json").write_text(strict_json(comparison.to_dict(), indent=1), encoding="utf-8")
    return page.write(folder / "comparison.html", overwrite)
