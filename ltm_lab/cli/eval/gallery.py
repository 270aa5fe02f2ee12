"""`ltm-lab eval gallery`: real photos with what the system makes of them, as a page."""

from pathlib import Path
from typing import Annotated

import typer

from ltm_core.vision.manifest import DEFAULT_DEPTH_MODEL, DEFAULT_MODEL
from ltm_lab.evaluation.gallery.parts import Part
from ltm_lab.options import JsonFile, writable_folder


def gallery(
    data: Annotated[Path, typer.Option(help="Folder of the real data, which is not part of the repository.")] = Path(
        "../shared/data"
    ),
    out: Annotated[Path, typer.Option(help="Folder for the page and its pictures.", callback=writable_folder)] = Path(
        "out/gallery"
    ),
    part: Annotated[list[Part] | None, typer.Option(help="Only this part; may be given several times.")] = None,
    model: Annotated[str, typer.Option(help="Label network, by name or manifest.")] = DEFAULT_MODEL,
    depth_model: Annotated[str, typer.Option(help="Depth network, by name or manifest.")] = DEFAULT_DEPTH_MODEL,
    json_path: JsonFile = None,
) -> None:
    """A page of real photos, chosen by rule: traced and fused depth, labels, terrain change, and what is wrong.

    Nothing of the data is copied into the repository: the pictures lie in --out alone.
    """
    from rich.console import Console

    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.evaluation.gallery.exhibit import Section
    from ltm_lab.evaluation.gallery.posed import Networks, canyon_section, engabreen_section
    from ltm_lab.evaluation.gallery.real_photos_io import require_photos
    from ltm_lab.evaluation.gallery.unposed import mountain_section, tower_section
    from ltm_lab.evaluation.gallery_report import figures_of, write_gallery
    from ltm_ros.pages import write_figures

    parts = tuple(dict.fromkeys(part or Part))
    require_photos(data, parts)
    networks, console = Networks.open(model, depth_model), Console()
    sections: list[Section] = []
    with console.status("reading") as status:
        for each in parts:
            match each:
                case Part.ENGABREEN:
                    sections.append(engabreen_section(data, networks, status.update))
                case Part.CANYON:
                    sections.append(canyon_section(data, networks, status.update))
                case Part.TOWERS:
                    sections.append(tower_section(data, networks.segmenter, status.update))
                case Part.MOUNTAINS:
                    sections.append(mountain_section(data, networks.segmenter, status.update))
    page = write_gallery(out, data, sections, (model, depth_model))
    for section in sections:
        rows = [
            (
                shown.name,
                f"{shown.fault:.1%}" if shown.fault == shown.fault else "-",
                "" if shown.fused is None else str(shown.fused.verdict),
            )
            for shown in section.worst_first()
        ]
        print_table(console, f"{section.title}: {section.fault}", ("photo", "wrong", "verdict of the fusion"), rows)
        for fact in section.facts:
            console.print(f"  {fact.name}: {fact.shown()}", highlight=False)
    if json_path is not None:
        write_figures(json_path, figures_of(sections))
    console.print(f"page: {page}", highlight=False, soft_wrap=True)
