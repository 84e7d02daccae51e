"""A study: many bags or seeds, a row each, in a folder that knows what is done already.

    rows/<key>.json    a row as soon as there is one, whole or not at all
    study.json         how all of them are identified
    study.parquet      the rows as one table (or study.csv)
    index.html         what they say together

A study that was interrupted goes on with the same command: rows that are there are not made again, unless their bag
has changed.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from beam_ident.report.page import write_whole
from beam_ros.errors import UsageError
from beam_ros.process.folder_lock import LOCK_NAME, FolderLock
from beam_ros.process.folders import make_folder
from beam_ros.process.strict_json import strict_json
from beam_ros.studies.rows import GatesOf, Item, Row, Settings, failed_row, study_row
from beam_ros.studies.workers import MOST_DEATHS, on_cluster, on_cores

SCHEMA = 1
Progress = Callable[[float, str], None]
"""Called with the number of rows that are done, and the name of the last."""


def open_study(folder: Path, settings: Settings, overwrite: bool = False) -> FolderLock:
    """Begin a study in a folder, or go on with the one that is there.

    Returns
    -------
    FolderLock -- the folder is this process's alone until it is released

    Raises
    ------
    UsageError
        The folder holds something else, or a study with other settings, and must not be overwritten; another process
        works in it.
    """
    mark = folder / "study.json"
    stated = json.loads(strict_json({"schema": SCHEMA, **settings.to_dict()}))
    begun = (LOCK_NAME, f".{mark.name}.partial")  # What a process leaves that is killed before anything else.
    if folder.exists() and (not folder.is_dir() or any(own.name not in begun for own in folder.iterdir())):
        if not mark.is_file():
            raise UsageError(f"{folder} exists and holds no study: expected a new folder; give another --out")
        if _read_json(mark) != stated and not overwrite:
            raise UsageError(
                f"{folder} holds a study with other options or another rig: expected the same to go on with it;"
                " give another --out, or --overwrite to begin anew"
            )
    lock = FolderLock(make_folder(folder))
    if overwrite:
        shutil.rmtree(folder / "rows", ignore_errors=True)
    write_whole(mark, strict_json(stated, indent=1) + "\n")
    (folder / "rows").mkdir(exist_ok=True)
    return lock


def run_study(
    items: Sequence[Item],
    settings: Settings,
    folder: Path,
    gates_of: GatesOf,
    *,
    n_workers: int = 1,
    scheduler: str | None = None,
    progress: Progress = lambda done, name: None,
) -> list[Row]:
    """Make the rows that are missing.

    Parameters
    ----------
    items : sequence of Item -- the bags, or the seeds
    settings : Settings
    folder : Path -- a study that ``open_study`` opened
    gates_of : callable -- what is said of a bag before it is identified
    n_workers : int -- processes on this machine
    scheduler : str, optional -- address of a Dask scheduler, whose workers see the bags under the same paths
    progress : callable

    Returns
    -------
    list of Row -- of all items, in their order

    Raises
    ------
    EstimationError
        The cluster is not there.
    """
    rows: dict[Item, Row] = {}
    for item in items:
        row = _read_json(_file(folder, item))
        if row is not None and row.get("mark") == item.mark:
            rows[item] = row
    missing = [item for item in items if item not in rows]
    progress(len(rows), "")
    work = partial(study_row, settings=settings, gates_of=gates_of)
    results: Iterable[tuple[Item, Row | None]] = ()
    if missing:
        results = on_cluster(work, missing, scheduler) if scheduler else on_cores(work, missing, n_workers)
    for item, found in results:
        row = found or failed_row(
            item, f"its worker died {MOST_DEATHS} times over it: too little memory, or a fault in a library"
        )
        write_whole(_file(folder, item), strict_json(row) + "\n")
        # As it reads again, so that a study that goes on says the same as one that was never interrupted.
        rows[item] = json.loads(strict_json(row))
        progress(len(rows), item.name)
    return [rows[item] for item in items]


def _file(folder: Path, item: Item) -> Path:
    return folder / "rows" / f"{item.key}.json"


def _read_json(path: Path) -> Row | None:
    """Return the content of a file, None where there is none or it is no JSON."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None
