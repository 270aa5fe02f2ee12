"""`ltm-lab eval segmentation`: compares label networks on labelled frames, rendered ones and photos."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ltm_lab.options import JsonFile, writable_folder


def segmentation(
    folder: Annotated[
        Path,
        Argument(help="Folder of pictures NAME.png or .jpg with NAME_labels.png or polygons.json, or of such folders."),
    ],
    networks: Annotated[str, Option(help="Label networks, separated by commas; default: the shipped one.")] = "",
    head: Annotated[
        list[str] | None,
        Option("--head", help="Score with this head too, a name or path; again for more. Default: none."),
    ] = None,
    json_path: JsonFile = None,
    threads: Annotated[int, Option(help="CPU threads.")] = 1,
    limit: Annotated[int | None, Option(min=1, help="Maximum number of frames of a folder.")] = None,
    macro: Annotated[
        str, Option(help="Classes of the macro F1, with commas.", metavar="CLASSES")
    ] = "sky,grass,shrub,tree,bare",
    ignore: Annotated[str, Option(help="True classes that are not counted, with commas.", metavar="CLASSES")] = "",
    confidence: Annotated[
        float | None,
        Option(min=0, max=0.99, help="Withdraw labels of lower probability. Default: the network's."),
    ] = None,
    tree_contrast: Annotated[
        float | None, Option(min=0, help="Withdraw tree of lower contrast, 8-bit steps, among more shrub.")
    ] = None,
    overlays: Annotated[
        Path | None,
        Option(help="Draw each frame's answer beside its truth, PNG, into this folder.", callback=writable_folder),
    ] = None,
) -> None:
    """Score networks on frames with true labels: F1 by class, confusion, sky, skyline, calibration, time.

    One table a folder. Labels of 255 are not counted. Skylines are compared at a width of 512 pixels. Risk is the share
    of labelled pixels that are wrong; at 80 % coverage, of those with the highest confidence.
    """
    import os
    import platform
    from functools import partial

    from rich.console import Console

    from ltm_core.base.errors import RecordingError
    from ltm_core.label_heads.labelled_frames import LABELS_SUFFIX, evenly, read_frames, without_classes
    from ltm_core.vision.areas import POLYGONS_FILE
    from ltm_core.vision.manifest import DEFAULT_MODEL, SHIPPED_LABEL_HEAD
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.cli.eval.score_table import names_in
    from ltm_lab.cli.eval.segmentation_tables import print_confusion, print_scores
    from ltm_lab.evaluation.segmentation.network_score import score_frames, write_overlay
    from ltm_ros.pages import write_figures

    inside = sorted(p for p in folder.iterdir() if p.is_dir() and _holds_frames(p)) if folder.is_dir() else []
    sets = [folder] if folder.is_dir() and _holds_frames(folder) else inside
    if not sets:
        raise RecordingError(
            f"{folder}: no frames; expected pictures NAME.png or .jpg with NAME{LABELS_SUFFIX} or {POLYGONS_FILE}, or "
            "folders of them"
        )
    console = Console()
    heads = [SHIPPED_LABEL_HEAD, *(head or [])]
    models = names_in(networks) or [DEFAULT_MODEL]
    segmenters = [Segmenter.open(name, threads, head=h) for name in models for h in heads]
    chosen = {"confidence": confidence, "tree_contrast": tree_contrast}
    for s in segmenters:
        s.withdraw_otherwise = {k: v for k, v in chosen.items() if v is not None}
    labels = segmenters[0].labels
    counted = tuple(labels.id_of(name) for name in names_in(macro))
    left_out = [labels.id_of(name) for name in names_in(ignore)]
    conditions = {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "threads": threads,
        "skyline_width": 512,
        "not_counted": ignore or "nothing",
        "withdrawn": "; ".join(dict.fromkeys(str(s.withdrawal) for s in segmenters)),
        "networks": ", ".join(s.described for s in segmenters),
    }
    result: dict[str, object] = {"conditions": conditions}
    console.print(", ".join(f"{key} {value}" for key, value in conditions.items()), highlight=False)
    for path in sets:
        frames = read_frames(path, len(labels), sampled=True)
        if limit is not None:
            frames = evenly(frames, limit)
        frames = without_classes(frames, left_out)
        scores = {}
        for s in segmenters:
            look = partial(write_overlay, overlays, s.name, labels) if overlays is not None else lambda *_: None
            scores[s.name] = score_frames(s, frames, counted, look)
        title = f"{path}: {len(frames)} frames, {next(iter(scores.values())).labels.pixels} labelled pixels"
        print_scores(console, labels.names, scores, title)
        for name, score in scores.items():
            print_confusion(console, labels.names, score.labels, name)
        result[path.resolve().name] = {name: score.summary(labels.names) for name, score in scores.items()}
    if json_path is not None:
        write_figures(json_path, result)


def _holds_frames(folder: Path) -> bool:
    from ltm_core.label_heads.labelled_frames import LABELS_SUFFIX
    from ltm_core.vision.areas import POLYGONS_FILE

    return any(folder.glob(f"*{LABELS_SUFFIX}")) or (folder / POLYGONS_FILE).is_file()
