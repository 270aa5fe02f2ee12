"""`ltm-lab eval areas`: label networks on the areas named in the listed photographs."""

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.options import JsonFile


def areas(
    photos: Annotated[Path, typer.Argument(help="Folder of the listed photos ID.jpg (landscape_photos.csv).")],
    networks: Annotated[str, typer.Option(help="Label networks, separated by commas; default: the shipped one.")] = "",
    role: Annotated[str, typer.Option(help="Which photos: train, validate, test or blind.")] = "test",
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 1,
    json_path: JsonFile = None,
) -> None:
    """Score networks on areas that a person named in real photos: by network, and by kind of photo.

    `land as sky or water` counts all areas of ground. Risk is the share of labelled pixels that are wrong; at 80 %
    coverage, of those with the highest confidence.
    """
    from dataclasses import asdict, astuple

    import numpy as np
    from rich.console import Console

    from ltm_core.base.errors import ConfigError
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.cli.eval.score_table import names_in, print_table
    from ltm_lab.evaluation.segmentation.area_score import ROLES, AreaScore, answers_of, area_score, listed_photos
    from ltm_ros.pages import write_figures

    if role not in ROLES:
        raise ConfigError(f"--role {role}: expected one of {', '.join(ROLES)}")
    listed = listed_photos(role)
    chosen = names_in(networks) or [DEFAULT_MODEL]
    answers = {name: answers_of(Segmenter.open(name, threads), listed, photos) for name in chosen}
    result: dict[str, dict[str, object]] = {}
    for name, said in answers.items():
        kinds = ["all", *sorted({a.kind for a in said})]
        scores = {k: area_score([a for a in said if k in ("all", a.kind)]) for k in kinds}
        rows = [
            (kind, str(score.areas), *(f"{v:.1%}" if np.isfinite(v) else "-" for v in astuple(score)[1:]))
            for kind, score in scores.items()
        ]
        columns = [field.replace("_", " ") for field in AreaScore.__dataclass_fields__]
        print_table(Console(), f"{name}: {len(listed)} photos ({role})", ("kind", *columns), rows)
        result[name] = {kind: asdict(score) for kind, score in scores.items()}
    if json_path is not None:
        write_figures(json_path, result)
