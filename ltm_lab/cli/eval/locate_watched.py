"""`ltm-lab eval locate --frames`: is a turned camera named by a fire's marks and by its pictures, rendered ones?"""

from __future__ import annotations

from collections import defaultdict
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_lab.evaluation.locating.watched_trials import WatchedCase
    from ltm_lab.evaluation.pose.pose_trial import PreparedFrame

_DEM_SIGMA = 1.0
_GAPS = (10.0, 3600.0)
"""Seconds between the last pictures before a turn and what follows: it was turned just now, or in an hour's fog."""
_HEADS, _FIXED = "heads that look around", "fixed cameras, one view each"


def watched(
    folders: list[Path],
    count: int,
    angle_sigma: float,
    dem_error: float | None,
    draw: int,
    console: Console,
    json_path: Path | None,
) -> None:
    """Cases with one of three eyes turned by 2 degrees, and as many with none; eyes as heads, and as fixed cameras."""
    import numpy as np
    from rich.table import Table

    from ltm_core.locating.settings import LocatingConfig
    from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
    from ltm_lab.evaluation.locating.smoke_trials import PoseErrors
    from ltm_lab.evaluation.locating.watched_eyes import AFTER, watched_eye
    from ltm_lab.evaluation.locating.watched_trials import WatchedScore, eyes_site, watched_cases
    from ltm_lab.evaluation.pose.rendered_terrain_io import rendered_terrain
    from ltm_ros.pages.figures_io import write_figures

    errors, pictures = PoseErrors(angle_sigma), PicturePoseConfig()
    error = _DEM_SIGMA if dem_error is None else dem_error
    config = LocatingConfig(dem_sigma=error)
    cases: dict[tuple[str, bool], list[WatchedCase]] = defaultdict(list)
    told = []
    for folder in folders:
        with console.status(folder.name):
            terrain = rendered_terrain(folder, alone=False, canopy=False)
            frames = _prepared(folder)
            for number, kind in enumerate((_HEADS, _FIXED)):
                rng = np.random.default_rng([draw, 13, number])
                eyes = []
                for name, views in frames.items():
                    shown = views if kind == _HEADS else [views[int(rng.integers(len(views)))]]
                    eyes.append(watched_eye(name, shown, terrain, errors, rng, pictures))
                site = eyes_site(folder.name, terrain.dem, eyes, error, draw)
                for turned in (True, False):
                    found = watched_cases(site, eyes, count, turned, errors, config, terrain.bend, draw)
                    cases[kind, turned] += found
                held = sum(eye.held for eye in eyes)
                told.append(f"{folder.name}, {kind}: {held} of {len(eyes)} mounts found before the turn")
    rows = []
    for kind in (_HEADS, _FIXED):
        table = Table(title=f"{kind}: three, one turned by 2 degrees; and none turned")
        for column in ("seconds without", "pictures since", "cases", "named by marks", "by pictures", "by both",
                       "right one named", "none turned", "named by marks", "by pictures", "by both"):  # fmt: skip
            table.add_column(column, justify="right")
        for gap, after in product(_GAPS, AFTER):
            one, none = (
                WatchedScore.of(cases[kind, turned], after, config.sure_of_wrong, gap) for turned in (True, False)
            )
            table.add_row(
                *(f"{gap:g}", str(after), str(one.count), f"{one.marks:.1%}", f"{one.pictures:.1%}"),
                *(f"{one.both:.1%}", f"{one.right_both:.1%}", str(none.count), f"{none.right_marks:.1%}"),
                *(f"{none.right_pictures:.1%}", f"{none.right_both:.1%}"),
            )
            told_of = {"kind": kind, "gap": gap}
            rows += [vars(one) | told_of | {"turned": True}, vars(none) | told_of | {"turned": False}]
        console.print(table)
    console.print(
        f"conditions: rendered pictures, geometric smoke clicked on by three eyes of "
        f"{', '.join(folder.name for folder in folders)}; poses stated to {angle_sigma:g} deg",
        highlight=False,
    )
    console.print("\n".join(told), highlight=False)
    if json_path is not None:
        write_figures(json_path, rows)
        console.print(f"  {json_path}", highlight=False)


def _prepared(folder: Path) -> dict[str, list[PreparedFrame]]:
    """By eye."""
    from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.pose.pose_trial import prepared
    from ltm_lab.evaluation.pose.rendered_terrain_io import rendered_terrain
    from ltm_lab.evaluation.truth_frames_io import read_truth_frames

    segmenter, terrain = Segmenter.open(DEFAULT_MODEL), rendered_terrain(folder, alone=False, canopy=False)
    frames: dict[str, list[PreparedFrame]] = defaultdict(list)
    for number, frame in enumerate(read_truth_frames(folder)):
        labels = segmenter.segment(frame.photo).labels
        name = f"{folder.name}/{number:04d}"
        frames[frame.camera_name].append(prepared(name, frame, labels, terrain, PicturePoseConfig()))
    return dict(frames)
