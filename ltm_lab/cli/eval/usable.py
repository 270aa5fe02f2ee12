"""`ltm-lab eval usable`: whether pictures that can be used are told from those that cannot."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


class Half(StrEnum):
    ALL = "all"
    A = "a"
    B = "b"

    def of(self, paths: list[Path]) -> list[Path]:
        return paths if self is Half.ALL else paths[0 if self is Half.A else 1 :: 2]


def usable(
    photos: Annotated[Path, typer.Argument(help="Folder of photos that can be used.")],
    half: Annotated[
        Half, typer.Option(help="Every second photo by name, from the first (a) or the second (b) on.")
    ] = Half.ALL,
    sun: Annotated[float | None, typer.Option(help="Take the sun to have stood so high, degrees.")] = None,
    json_path: JsonFile = None,
) -> None:
    """Count clear photos that are refused, by reason and name, and photos spoilt on purpose that are told."""
    import time

    import cv2
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from ltm_core.storage.photo_io import read_rgb
    from ltm_core.vision.usable import judge
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.evaluation.segmentation.spoilt_pictures import WAYS, spoilt
    from ltm_ros.recordings.camera_pictures import pictures_in

    paths = half.of(pictures_in(photos))
    refused: dict[str, str] = {}
    told = dict.fromkeys(WAYS, 0)
    kept = dict.fromkeys(WAYS, 0)
    doubtful, spent = [], 0.0
    for number, path in enumerate(paths):
        photo = read_rgb(path)
        large = np.asarray(cv2.resize(photo, (1920, 1080)), np.uint8)
        begin = time.process_time()
        judge(large)
        spent += time.process_time() - begin
        found = judge(photo, sun_deg=sun)
        doubtful.append(float(found.doubtful.mean()))
        if found.reason is not None:
            refused[path.name] = str(found.reason)
        for way, wanted in WAYS.items():
            said = judge(spoilt(photo, way, number)).reason
            told[way] += said is wanted
            kept[way] += said is None
    count = len(paths)
    console = Console()
    table = Table("photos", "refused", "for that reason", title=f"{count} photos of {photos}, half {half}")
    table.add_row("as they are", f"{len(refused)} ({len(refused) / count:.1%})", "")
    for way in WAYS:
        table.add_row(way, f"{1 - kept[way] / count:.1%}", f"{told[way] / count:.1%}")
    console.print(table)
    for name, reason in refused.items():
        console.print(f"  {name}: {reason}", highlight=False)
    milliseconds = 1e3 * spent / count
    console.print(
        f"{np.mean(doubtful):.2%} of the clear photos burnt out or black; {milliseconds:.1f} ms of processor time at "
        "1920 x 1080",
        highlight=False,
    )
    if json_path is not None:
        ways = {way: {"refused": 1 - kept[way] / count, "told": told[way] / count} for way in WAYS}
        write_figures(json_path, {"photos": count, "refused": refused, "spoilt": ways, "milliseconds": milliseconds})
