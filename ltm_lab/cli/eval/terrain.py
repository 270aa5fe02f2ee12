"""`ltm-lab eval terrain`: scores the surface map on exact scenes, a real site, frames with truth, or a recorded run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile, writable_folder

HELD_OUT = "23,24,25"
"""Seeds that no constant of the map was chosen on: those were chosen on seeds 1, 2, 11, 12 and 13; 14 to 22 were looked
at before the last of them was."""


def terrain(
    scenes: Annotated[str, typer.Option(help="Scenes, with commas; empty: all of them.")] = "",
    pose_errors: Annotated[
        str, typer.Option(help="Degrees by which each angle of a pose is off, sigma; with commas.")
    ] = "0,0.5,2",
    occluded: Annotated[str, typer.Option(help="Shares of each image that something nearer hides; commas.")] = "0,0.4",
    both: Annotated[
        bool, typer.Option("--both", help="Also every pose error with every occlusion, not one at a time only.")
    ] = False,
    seeds: Annotated[str, typer.Option(help="Of ground, plants, poses and noise; commas.")] = HELD_OUT,
    looks: Annotated[
        int | None,
        typer.Option(help="Images of each tower, two hours apart (3); with --frames: looks at each photo (1).", min=1),
    ] = None,
    lasting: Annotated[
        float,
        typer.Option(help="Of the noise that neighbouring pixels share: what all images of a tower do.", min=0, max=1),
    ] = 0.3,
    share: Annotated[float, typer.Option(help="Sigma of the measured depth as a share of range.", min=0)] = 0.01,
    canyon: Annotated[
        Path | None,
        typer.Option(help="Instead: the real site rm22 of sandbar_seg, with later surveys, in this folder."),
    ] = None,
    frames: Annotated[
        Path | None, typer.Option(help="Instead: frames of `ltm-lab simulate` with two dates, in this folder.")
    ] = None,
    bag: Annotated[
        Path | None, typer.Option(help="Instead: a recorded run with a terrain node, and truth beside its site.")
    ] = None,
    network: Annotated[
        list[str] | None,
        typer.Option(help="With --canyon or --frames: also what this depth network measures; repeatable."),
    ] = None,
    alike: Annotated[
        bool, typer.Option("--alike", help="With --frames and --network: how much of an error repeats on all dates.")
    ] = False,
    watched: Annotated[
        int, typer.Option(help="With --frames: looks at each photo of the first date before that.", min=0)
    ] = 0,
    site: Annotated[Path | None, typer.Option(help="With --bag: site file; default: beside the bag.")] = None,
    truth: Annotated[Path | None, typer.Option(help="With --bag: folder of truth rasters.")] = None,
    date: Annotated[str, typer.Option(help="With --bag or --frames: the date of the truth.")] = "",
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for a sheet of pictures of each run.", callback=writable_folder)
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Change and surface from two towers against the truth, by scene, pose error and occlusion.

    Scenes stand 500 m from the towers. Pose errors are run without occlusion, occlusion with exact poses, unless --both
    is given.
    """
    from ltm_core.base.errors import ConfigError
    from ltm_core.vision.manifest import DEFAULT_DEPTH_MODEL
    from ltm_lab.cli.eval import terrain_tables

    if sum(given is not None for given in (canyon, frames, bag)) > 1:
        raise ConfigError("give one of --canyon, --frames and --bag")
    if canyon is not None:
        terrain_tables.real_site(canyon, network or [], pictures, json_path)
        return
    if frames is not None and alike:
        terrain_tables.repeated_errors(frames, network or [DEFAULT_DEPTH_MODEL])
        return
    if frames is not None:
        terrain_tables.simulated_frames(frames, date, share, looks or 1, watched, network or [], pictures, json_path)
        return
    if bag is not None:
        terrain_tables.recorded_run(bag, site, truth, date, json_path)
        return
    from dataclasses import replace

    from ltm_lab.evaluation.terrain.hillside_scenes import SCENES, Noise, SceneConditions

    errors = _numbers(pose_errors, "pose-errors", 10)
    shares = _numbers(occluded, "occluded", 0.9)
    base = SceneConditions(looks=looks or 3, noise=Noise(share=share, lasting=lasting))
    runs = [
        replace(base, pose_error_deg=error, occluded=part)
        for part in shares
        for error in errors
        if both or error == 0 or part == 0
    ]
    if not runs:
        raise ConfigError("no run is left: --pose-errors or --occluded must hold a 0, or give --both")
    terrain_tables.scenes(
        scenes.split(",") if scenes else list(SCENES),
        runs,
        [round(seed) for seed in _numbers(seeds, "seeds", 1e9)],
        pictures,
        json_path,
    )


def _numbers(text: str, name: str, most: float) -> list[float]:
    from ltm_core.base.errors import ConfigError

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise ConfigError(f"--{name} must be numbers with commas, got {text!r}") from error
    if not all(0 <= value <= most for value in values):
        raise ConfigError(f"--{name} must lie between 0 and {most:g}, got {text!r}")
    return values
