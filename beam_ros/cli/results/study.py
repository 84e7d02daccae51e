"""Identify many bags, one row each in one table, with a page that sums them up.

BAGS are bags, folders that hold bags at any depth, quoted patterns, or files of columns with --input and --output.
The work runs on the cores of this machine, or on a Dask cluster whose workers see the same paths. A bag that cannot
be identified is a row with its error. An
interrupted study goes on with the same command and --out. With --simulate, experiments on the simulated rig with
seeds of their own take the place of bags: how often do the intervals hold the truth?
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

from beam_ros.cli.options import add_rig_file, read_rig, run_folder
from beam_ros.cli.results.identify import add_options, epilog, parameters, read_settings
from beam_ros.errors import UsageError
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json

__all__ = ["add_arguments", "epilog", "run"]

_LEFT_OUT = ("report", "validate", "overwrite")
"""Options of ``beam identify`` that mean something else here, or nothing."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "bags", nargs="*", metavar="BAGS", help="bags, folders of bags, quoted patterns, or files"
    )
    parser.add_argument("--simulate", type=int, metavar="N", help="instead of bags: N simulated experiments")
    parser.add_argument("--seed", type=int, default=1, help="of the first simulated experiment (default: 1)")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the study, new or begun; by default a new one in runs/",
    )
    parser.add_argument("--csv", action="store_true", help="write study.csv instead of study.parquet")
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        help="processes on this machine (default: one a core)",
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster, as tcp://host:8786")
    parser.add_argument("--overwrite", action="store_true", help="begin a study anew that is there already")
    add_options(parser, [name for name in parameters() if name not in _LEFT_OUT])
    add_rig_file(parser)
    parser.add_argument("--json", action="store_true", help="print the statistics of the modes as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    from beam_ros.checks.bag_check import gates_of_bag
    from beam_ros.studies.rows import Item, Settings, find_bags
    from beam_ros.studies.statistics import mode_statistics
    from beam_ros.studies.study import open_study, run_study
    from beam_ros.studies.summary import format_study, study_page
    from beam_ros.studies.table import require_parquet, write_table

    count = arguments.simulate
    if (count is None) == (not arguments.bags):
        raise UsageError("expected either bags or --simulate N; name what to study")
    for name in ("simulate", "jobs"):
        value = getattr(arguments, name)
        if value is not None and value < 1:
            raise UsageError(f"--{name} is {value}: expected at least 1")
    if not arguments.csv:
        require_parquet()
    if count is None:
        items = [Item(bag=path) for path in find_bags(arguments.bags)]
    else:
        items = [Item(seed=seed) for seed in range(arguments.seed, arguments.seed + count)]
    identifier, rig = read_settings(arguments)
    # What says where, not how: a study goes on wherever it was begun.
    identifier = replace(identifier, bag="", report="", validate="", overwrite=False)
    settings = Settings(identifier, read_rig(arguments) if count else rig)
    folder = arguments.out or run_folder(None, "study")
    with open_study(folder, settings, arguments.overwrite), Progress("study", len(items), "rows") as stage:
        try:
            rows = run_study(
                items,
                settings,
                folder,
                gates_of_bag,
                n_workers=arguments.jobs,
                scheduler=arguments.scheduler,
                progress=lambda done, name: stage.update(done, Path(name).name),
            )
        except KeyboardInterrupt:
            stage.finish(f"interrupted; the same command with --out {folder} goes on")
            raise
        table = write_table(rows, folder, arguments.csv)
        page = study_page(rows, settings, table).write(folder / "index.html", overwrite=True)
        stage.finish(f"{len(rows)} rows in {table}")
    if arguments.json:
        statistics = [own.to_dict() for own in mode_statistics(rows)]
        print(strict_json({"table": str(table), "page": str(page), "modes": statistics}, indent=2))
    else:
        print(format_study(rows))
        print(f"page     {page}\ntable    {table}")
    return 0 if any(not row["error"] for row in rows) else 1
