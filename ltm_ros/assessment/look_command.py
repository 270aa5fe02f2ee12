"""`ltm assess look` and `ltm assess learn`: name what grows in sampled cells, and let the network learn from it."""

from pathlib import Path
from typing import Annotated

import typer

PlanFolder = Annotated[Path, typer.Argument(help="Folder of the plan, written by `ltm assess plan`.")]
SiteFile = Annotated[Path | None, typer.Option(help="Site file of the cameras. Default: the plan's.")]
Recordings = Annotated[
    list[Path], typer.Option(help="Recording, or folder of recordings, of the cameras. Repeatable.", metavar="FOLDER")
]


def look(
    plan: PlanFolder,
    recordings: Recordings,
    site: SiteFile = None,
    interpreter: Annotated[
        str, typer.Option(help="Name of the interpreter; each has a file of answers.", metavar="NAME")
    ] = "first",
    imagery: Annotated[
        str, typer.Option(help="Orthophoto: GeoTIFF, or URL of tiles with {z}, {x}, {y}.", metavar="FILE|URL")
    ] = "",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Local TCP port; 0: a free one.")] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in a browser.")] = True,
) -> None:
    """Name what grows in the sampled cells, on a web page that only this machine can open. Each cell is outlined in its
    three best photos. Answers are stored at once in PLAN/answers/NAME.csv; the page continues where you stopped. It
    never shows the map's answer. Ctrl-C ends the program."""
    from functools import partial

    from ltm_core.site.site_io import load_site
    from ltm_core.storage.disk_io import require_files
    from ltm_ros.assessment.answers_io import read_plan
    from ltm_ros.assessment.cell_photos import PhotoIndex
    from ltm_ros.assessment.look_session import LookServer, LookSession
    from ltm_ros.labelling.server import serve

    sampled = read_plan(plan)
    loaded = load_site(site or Path(sampled.site))
    require_files([sampled.answers_file(interpreter)], what="answers")
    session = LookSession(sampled, loaded, PhotoIndex(loaded, recordings), interpreter, imagery)
    serve(partial(LookServer, session), port, browser)


def learn(plan: PlanFolder, recordings: Recordings, site: SiteFile = None) -> None:
    """Turn half of the answers into labelled photos for `ltm train head`; these cells no longer count in the report.
    Only cells on which all interpreters agree, and are not unsure, are used."""
    from ltm_core.site.networks import label_model
    from ltm_core.site.site_io import load_site
    from ltm_core.storage.disk_io import require_folder
    from ltm_ros.assessment.answers_io import read_plan
    from ltm_ros.assessment.cell_photos import PhotoIndex
    from ltm_ros.assessment.learning import learn as learn_from

    sampled = read_plan(plan)
    path = site or Path(sampled.site)
    loaded = load_site(path)
    require_folder(plan)
    found = learn_from(sampled, PhotoIndex(loaded, recordings))
    model = Path(label_model(loaded)).stem
    typer.echo(
        f"{found.areas} areas of {found.cells} cells in {found.photos} photos: {found.folder}\n"
        f"{found.report_cells} cells remain for the report\n"
        f"train a label head:      ltm train head {found.folder} --out {loaded.name}\n"
        f"measure its reliability: ltm models measure {model} {recordings[0]} --site {path} --photos {found.folder}"
    )
