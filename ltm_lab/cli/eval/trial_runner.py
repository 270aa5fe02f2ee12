"""Runs the trials of `ltm-lab eval` on several processes and reports their rows.

A job is what one call works on, such as a rendered site or a seed. It draws its own random numbers, so that the rows
are the same whatever the number of processes.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console

Job = TypeVar("Job")
Row = TypeVar("Row")
Processes = Annotated[int, typer.Option(help="Number of processes; each holds a site of its own.", min=1)]


def run_trials(run: Callable[[Job], Sequence[Row]], jobs: Sequence[Job], processes: int, console: Console) -> list[Row]:
    """Return the rows that `run` makes of the jobs, in the order of the jobs.

    `run` must be a function of a module if there are several processes. What it raises ends the run.
    """
    processes = min(processes, len(jobs))
    with console.status("") as status:

        def watched(results: Iterable[Sequence[Row]]) -> Iterator[Sequence[Row]]:
            for done, rows in enumerate(results, 1):
                status.update(f"{done} of {len(jobs)} jobs done")
                yield rows

        if processes <= 1:
            return [*chain.from_iterable(watched(map(run, jobs)))]
        threads = max(1, (os.cpu_count() or 1) // processes)
        with ProcessPoolExecutor(processes, get_context("spawn"), _limit_threads, (threads,)) as pool:
            return [*chain.from_iterable(watched(pool.map(run, jobs)))]


def report(console: Console, conditions: str, rows: Sequence[Any], json_path: Path | None, **figures: Any) -> None:
    """Print the conditions of trials. Write them, `figures` and the rows, which are dataclasses, to `json_path`."""
    from ltm_ros.pages import write_figures

    console.print(f"conditions: {conditions}", highlight=False)
    if json_path is not None:
        write_figures(json_path, {"conditions": conditions, **figures, "trials": [asdict(row) for row in rows]})


def _limit_threads(count: int) -> None:
    from ltm_core.base.kernels import limit_kernel_threads

    limit_kernel_threads(count)
