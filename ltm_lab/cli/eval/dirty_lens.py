"""`ltm-lab eval dirty-lens`: whether a lens that became dirty is told, and a clean one is not."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.cli.eval.usable import Half
from ltm_ros.cli.output import JsonFile


def dirty_lens(
    photos: Annotated[
        Path | None, typer.Argument(help="Folder of photos, of each of which a camera's series of pictures is made.")
    ] = None,
    half: Annotated[
        Half, typer.Option(help="Every second photo by name, from the first (a) or the second (b) on.")
    ] = Half.ALL,
    most: Annotated[int, typer.Option(min=1, help="Photos that are taken, spread over the half.")] = 40,
    frames: Annotated[
        Path | None,
        typer.Option(help="Folder of photos CAMERA_YYYYMMDD...: each is held against the others of its camera."),
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Count series of pictures with dirt drawn onto the lens that are told, and series without that are told too."""
    from rich.console import Console
    from rich.table import Table

    from ltm_core.base.errors import ConfigError
    from ltm_core.base.evenly import evenly
    from ltm_core.storage.photo_io import read_rgb
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.evaluation.segmentation.dirty_pictures import CASES, CLEAN, told_dirty
    from ltm_ros.recordings.camera_pictures import pictures_in, pictures_of_cameras

    if photos is None and frames is None:
        raise ConfigError("give a folder of photos, or --frames FOLDER, or both")
    console = Console()
    figures: dict[str, object] = {}
    if photos is not None:
        chosen = evenly(half.of(pictures_in(photos)), most)
        told = dict.fromkeys(CASES, 0)
        for number, path in enumerate(chosen):
            for case, said in told_dirty(read_rgb(path), number).items():
                told[case] += said
        table = Table("the lens", "told as dirty", title=f"{len(chosen)} photos of {photos}, half {half}")
        for number, (case, count) in enumerate(told.items()):
            table.add_row(case, f"{count} of {len(chosen)}", end_section=number == CLEAN - 1)
        console.print(table)
        figures["photos"] = {"count": len(chosen), "told": told}
    if frames is not None:
        wrong: dict[str, list[str]] = {}
        of: dict[str, int] = {}
        for camera, paths in pictures_of_cameras(frames).items():
            pictures = [read_rgb(path) for path in paths]
            of[camera] = len(paths)
            wrong[camera] = [
                path.name
                for k, path in enumerate(paths)
                if any(told_dirty(pictures[k], k, tuple(pictures[:k] + pictures[k + 1 :]), dirt=False).values())
            ]
        table = Table("camera", "frames", "told as dirty, wrongly", title=f"frames of one camera, {frames}")
        for camera, names in wrong.items():
            table.add_row(camera, str(of[camera]), ", ".join(names) or "none")
        console.print(table)
        figures["frames"] = {"count": of, "told": wrong}
    if json_path is not None:
        write_figures(json_path, figures)
