"""`ltm-lab train domains`: measures where the pictures lie that taught a network, for heads to be chosen by the picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import writable_file


def domains(
    folders: Annotated[
        list[Path], typer.Argument(help="Folders of pictures that the network was taught on; each counts alike.")
    ],
    model: Annotated[str, typer.Option(help="The network: name or manifest.")] = "landscape_lite0",
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The file; default: beside the manifest.", callback=writable_file),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many of a folder, evenly chosen.")] = None,
    threads: Annotated[int, typer.Option(help="CPU threads of the network.")] = 1,
) -> None:
    """Measure what `label_head: auto` compares a camera's pictures with: statistics of a decoder map over land in
    FOLDERS.

    Heads that were taught before lie on the axes of the former file; they are passed over until they are taught again.
    """
    import numpy as np
    from rich.console import Console

    from ltm_core.base.errors import ModelError
    from ltm_core.base.evenly import evenly
    from ltm_core.storage.photo_io import read_rgb
    from ltm_core.vision.picture_domain_io import domain_path, write_domain
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.training.domain_fit import fit_space, picture_statistics
    from ltm_ros.recordings.camera_pictures import pictures_in

    console, segmenter = Console(), Segmenter.open(model, threads)
    sets, told = [], []
    with console.status("measuring"):
        for folder in folders:
            paths = pictures_in(folder)
            paths = paths if limit is None else evenly(paths, limit)
            found = [picture_statistics(segmenter, read_rgb(path)) for path in paths]
            rows = [row for row in found if row is not None]
            if not rows:
                raise ModelError(f"{folder}: none of {len(paths)} pictures shows land; give pictures of landscapes")
            sets.append(np.array(rows))
            told.append(f"{folder.resolve().name} ({len(rows)} pictures)")
    space = fit_space(segmenter.manifest, sets, ", ".join(told))
    path = domain_path(segmenter.manifest) if out is None else out
    write_domain(path, space)
    console.print(f"{space.measured_on}: {len(space.axes)} axes; written: {path}", highlight=False)
