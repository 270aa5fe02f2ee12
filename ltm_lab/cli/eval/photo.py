"""`ltm-lab eval photo`: a real photo with surveyed control points through the live graph."""

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.demo import clear_demo
from ltm_ros.cli.output import print_table


def photo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/demo-real"),
    domain: Annotated[int, typer.Option(min=0, max=232, help="ROS domain of the graph.")] = 87,
) -> None:
    """Run the live graph on the photo of Engabreen, if its data is present, and compare its control points."""
    from ltm_core.base.resources import config_path
    from ltm_lab.evaluation.real_photo import medians, run_real_demo
    from ltm_ros.cli.output import print_nodes, progress_bar, say

    clear_demo(out)
    site, poses = config_path("sites/engabreen.yaml"), config_path("sites/engabreen_poses.csv")
    with progress_bar("photo", loops=True) as progress:
        points, nodes = run_real_demo(site, poses, out, domain, progress, say)
    print_nodes(nodes)
    columns = (">point", ">range m", ">distance m", ">hidden by the DEM")
    rows = ((p.name, f"{p.range:.0f}", f"{p.distance:.2f}", "yes" if p.hidden else "") for p in points)
    print_table("control points: traced and surveyed positions", columns, rows)
    over_all, over_clear = medians(points)
    say(f"median {over_all:.2f} m over all points, {over_clear:.2f} m over points not hidden by the DEM")
    say(f"report: {out / 'report.html'}")
