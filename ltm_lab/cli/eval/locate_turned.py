"""`ltm-lab eval locate --fires`: whether a turned camera is named by the marks of several fires."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_core.raster.dem import Dem
    from ltm_lab.evaluation.locating.turned_trials import NamingScore

_STEPS = (1, 2, 3, 5, 8, 12)
"""Numbers of fires that are told of, up to the one that is asked for."""


def naming(
    sites: list[tuple[str, Dem, int]],
    count: int,
    fires: int,
    angle_sigma: float,
    dem_error: float | None,
    console: Console,
    json_path: Path | None,
) -> None:
    """Cases with one camera turned by 2 degrees, and as many with none."""
    from rich.table import Table

    from ltm_core.locating.settings import LocatingConfig
    from ltm_lab.bench.measure import conditions
    from ltm_lab.evaluation.locating.smoke_sites import smoke_site
    from ltm_lab.evaluation.locating.smoke_trials import PoseErrors
    from ltm_lab.evaluation.locating.turned_trials import EXACTLY, NamingScore, TurnedCase, turned_cases
    from ltm_ros.pages.figures_io import write_figures

    machine = conditions(("numpy", "numba", "scipy"))
    sure = LocatingConfig().sure_of_wrong
    console.print(
        f"{machine.cpu}, {machine.cores} cores. Geometric smoke (no picture is rendered), clicked on by three cameras; "
        f"sigma of each angle {angle_sigma:g} deg, the same at all fires; named above {sure:.0%}; {count} cases a site",
        highlight=False,
    )
    cases: dict[bool, list[TurnedCase]] = {True: [], False: []}
    with console.status("looking"):
        for name, dem, seed in sites:
            error = 0.1 * dem.geometry.resolution if dem_error is None else dem_error
            site, config = smoke_site(name, dem, error, seed), LocatingConfig(dem_sigma=error)
            for turned, found in cases.items():
                found += turned_cases(site, count, fires, turned, PoseErrors(angle_sigma), config, seed)
    table = Table(title="three cameras, one turned by 2 degrees; and none turned")
    columns = ("fires", "cases", "named", "right one named", "most suspect", "turn off, median", "none turned", "named")
    for column in columns:
        table.add_column(column, justify="right")
    rows = []
    for number in sorted({*(step for step in _STEPS if step < fires), fires}):
        one = NamingScore.of(cases[True], number, sure)
        none = NamingScore.of(cases[False], number, sure)
        table.add_row(
            *(str(number), str(one.count), f"{one.named:.1%}", f"{one.wrongly_named:.1%}", f"{one.suspect:.1%}"),
            *(f"{one.off_deg:.2f} deg", str(none.count), f"{none.wrongly_named:.1%}"),
        )
        rows += [one.row() | {"turned": True}, none.row() | {"turned": False}]
    console.print(table)
    told = sum(case.told for case in cases[True]) / len(cases[True])
    console.print(f"of one fire, told that one camera is off by exactly 2 degrees: {told:.1%} right", highlight=False)
    known = [NamingScore.of(cases[turned], 1, sure, slips=EXACTLY) for turned in (True, False)]
    console.print(f"told that one may be, and that it is by exactly 2 degrees: {_named(*known)}", highlight=False)
    if json_path is not None:
        write_figures(json_path, rows)
        console.print(f"  {json_path}", highlight=False)


def _named(one: NamingScore, none: NamingScore) -> str:
    return (
        f"{one.named:.1%} named, a right one in {one.wrongly_named:.1%}; where none is turned, one in "
        f"{none.wrongly_named:.1%}"
    )
