"""Turn half of the reference answers into training areas; those cells stay out of the report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.vision.areas import POLYGONS_FILE, NamedArea, replace_file, write_areas
from ltm_core.vision.labels import LabelSet
from ltm_ros.assessment.answers_io import Plan, read_answers, write_table
from ltm_ros.assessment.cell_photos import PhotoIndex

_INCIDENCE_DEG: Final = 85.0
"""Incidence above which an outline on the bare ground is too flat to hold the plants of its cell."""


@dataclass(frozen=True)
class Learned:
    """What `learn` has written: the folder of photos and areas, the cells in it, and the cells left for the report."""

    folder: Path
    cells: int
    areas: int
    photos: int
    report_cells: int


def agreed_forms(plan: Plan) -> dict[int, str]:
    """Return the life forms that all interpreters of a cell name alike, at least as likely. Raises ConfigError."""
    named: dict[int, set[str]] = {}
    for interpreter in plan.interpreters():
        for answer in read_answers(plan.answers_file(interpreter)):
            clear = answer.certainty in ("sure", "likely")
            named.setdefault(answer.cell, set()).add(answer.life_form if clear else "")
    return {cell: next(iter(forms)) for cell, forms in named.items() if len(forms) == 1 and "" not in forms}


def learn(plan: Plan, photos: PhotoIndex) -> Learned:
    """Write the agreed answers of every second cell as labelled photos to PLAN/training, and all these cells to
    PLAN/learned.csv.

    The plan's cells are in random order, so both halves are random samples of each stratum. The report leaves out the
    whole half: without its agreed cells only, it would count too many cells that are hard to name. `ltm train head` and
    `ltm models measure --photos` read the folder. Raises ConfigError if there is nothing to learn, OSError."""
    forms, names = agreed_forms(plan), LabelSet.load().names
    folder = plan.folder / "training"
    folder.mkdir(exist_ok=True)
    areas: list[NamedArea] = []
    half, used, images = plan.cells[::2], set(), set()
    for cell in half:
        form = forms.get(cell.cell)
        if form is None or form not in names:
            continue
        for photo in photos.best(cell, plan.cell_m):
            if photo.incidence_deg > _INCIDENCE_DEG:
                continue
            name = f"{photo.camera_name}_{photo.stamp_ns}.jpg"
            if name not in images:
                replace_file(folder / name, photo.jpeg)
                images.add(name)
            outline = tuple((float(u), float(v)) for u, v in np.round(photo.outline, 1))
            areas.append(NamedArea(image=name, kind=form, polygon=outline))
            used.add(cell.cell)
    if not areas:
        raise ConfigError(f"{plan.folder}: no agreed answer has a photo; answer cells with `ltm assess look`")
    # First the cells that are excluded from the report: a crash in between must not let them count.
    write_table(plan.folder / "learned.csv", ["cell"], ({"cell": cell.cell} for cell in half))
    write_areas(folder / POLYGONS_FILE, areas)
    return Learned(folder, len(used), len(areas), len(images), len(forms.keys() - {cell.cell for cell in half}))
