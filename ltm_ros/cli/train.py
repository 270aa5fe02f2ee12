"""`ltm train head`: train a label head for a site from a few labelled photos."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Argument, Option

from ltm_core.base.errors import ModelError
from ltm_core.label_heads.head_trial import HeadScore, teach_head
from ltm_core.label_heads.labelled_frames import read_frames, without_classes
from ltm_core.vision.label_head import label_heads_folder, write_label_head
from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest, Withdrawal
from ltm_core.vision.segmenter import Segmenter
from ltm_ros.cli.output import command_group, print_table, say, working


def _print_scores(names: tuple[str, ...], scores: Mapping[str, HeadScore], title: str) -> None:
    """Print a table with a column for each network and a row for each figure; classes without truth have no row."""
    each = list(scores.values())
    first = each[0].labels
    among = ", ".join(names[k] for k in each[0].macro if first.true[k] > 0)
    rows = [
        (f"F1 {name} ({first.true[k] / first.pixels:.1%})", [float(s.labels.f1[k]) for s in each])
        for k, name in enumerate(names)
        if first.true[k] > 0
    ]
    rows += [
        (f"macro F1 ({among})", [s.macro_f1 for s in each]),
        ("correct share of pixels", [s.labels.accuracy for s in each]),
        ("unlabelled share of pixels", [s.labels.unlabelled for s in each]),
        ("calibration error (ECE)", [s.calibration.ece for s in each]),
        ("calibration error on land", [s.land_calibration.ece for s in each]),
        ("risk on land", [s.land_calibration.risk() for s in each]),
        ("risk on land at 80 % coverage", [s.land_calibration.risk(0.8) for s in each]),
    ]
    shown = ((label, *(f"{v:.3f}" if math.isfinite(v) else "-" for v in values)) for label, values in rows)
    print_table(title, ("", *(f">{name}" for name in scores)), shown)


def head(
    photos: Annotated[Path, Argument(help="Folder of labelled photos; sites.csv or NAME up to _ is the site.")],
    out: Annotated[str, Option("--out", "-o", help="Name of the label head, or path of its file (.yaml).")],
    model: Annotated[str | None, Option(help="Network, maybe with a label head. Default: the shipped one.")] = None,
    one_view: Annotated[bool, Option("--one-view", help="All PHOTOS show one view; the head is only for it.")] = False,
    licence: Annotated[str, Option(help="Licence of the photos, for the head's file.")] = "",
    ignore: Annotated[str, Option(help="True classes to ignore, separated by commas.", metavar="CLASSES")] = "",
    confidence: Annotated[float, Option(min=0, max=0.99, help="Pixels of lower probability stay unlabelled.")] = 0.4,
) -> None:
    """Train a label head on PHOTOS, evaluate it on held-out sites, and install it if it is better.

    The calibration and the confusion of its labels are measured on the held-out photos and written with it. Unless
    --out is a path, the head goes to the user's models, and `label_head: NAME` of a camera selects it."""
    segmenter = Segmenter(NetworkManifest.find(model or DEFAULT_MODEL).serving(out))
    manifest, names = segmenter.manifest, segmenter.labels.names
    path = Path(out) if out.endswith((".yaml", ".yml")) else label_heads_folder(manifest) / f"{out}.yaml"
    left_out = [segmenter.labels.id_of(n.strip()) for n in ignore.split(",") if n.strip()]
    frames = without_classes(read_frames(photos, len(names)), left_out)
    made = f"ltm train head {photos.resolve().name}, {len(frames)} photos, numpy {np.__version__}"
    with working("training"):
        trial = teach_head(segmenter, frames, path.stem, made, licence, Withdrawal(confidence=confidence), one_view)
    say(f"{len(frames)} photos of {', '.join(trial.sites)}; held out {trial.folds}; network {segmenter.described}")
    scores = {"the network": trial.before, f"head {path.stem}, held out": trial.after}
    _print_scores(names, scores, f"{photos}: heads trained on the other sites")
    if trial.after.macro_f1 <= trial.before.macro_f1:
        raise ModelError(
            f"head {path.stem!r} is not installed: its macro F1 on held-out photos is {trial.after.macro_f1:.3f}, that "
            f"of the network alone {trial.before.macro_f1:.3f}; label photos of more sites, with every class"
        )
    write_label_head(path, trial.file)
    say(
        f"macro F1 {trial.before.macro_f1:.3f} -> {trial.after.macro_f1:.3f}; written: {path}. To use it, set "
        f"`label_head: {path.stem}` of a camera in the site file"
    )


train = command_group("Train a label head for your site from a few labelled photos.")


@train.callback()
def _commands() -> None:
    """Keep `head` a subcommand while it is the only one."""


train.command()(head)
