"""`ltm-lab eval update`: whether depth follows the surface that views have confirmed, offline or in the live graph."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile, writable_folder


def update(
    scenes: Annotated[str, typer.Option(help="Exact hillside scenes of `ltm-lab eval terrain`, with commas.")] = (
        "felled,burn"
    ),
    seed: Annotated[int, typer.Option(help="Of ground, plants and noise.")] = 23,
    looks: Annotated[
        int, typer.Option(help="Images of each tower, two hours apart; the later half after the change is confirmed.")
    ] = 4,
    live: Annotated[bool, typer.Option("--live", help="Through processes on DDS, instead of offline twice.")] = False,
    kills: Annotated[
        bool, typer.Option("--kills", help="With --live: kill -9 each process while the surface changes.")
    ] = False,
    layout: Annotated[str, typer.Option(help="Of processes: site (all cameras share one) or node.")] = "site",
    domain: Annotated[int | None, typer.Option(help="ROS domain of --live.")] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(help="Folder for a picture of each scene: depth before and after.", callback=writable_folder),
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Median error of traced depth over truly changed cells, before the surface is confirmed and after.

    What the towers measure is made, of a known surface; poses are exact. An offline run is done twice and must repeat
    to the bit.
    """
    import tempfile
    from dataclasses import asdict

    from ltm_core.base.errors import ConfigError
    from ltm_core.pictures import to_png
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.evaluation.terrain.hillside_scenes import trial
    from ltm_lab.evaluation.update_score import score_update, update_sheet
    from ltm_lab.evaluation.update_site import NAME, write_update_site
    from ltm_lab.evaluation.update_trial import live_depths, offline_depths
    from ltm_ros.launching.node_log import new_log_folder

    if layout not in ("site", "node"):
        raise ConfigError(f"--layout {layout}: there are site and node")
    if kills and not live:
        raise ConfigError("--kills ends processes, of which an offline run has none: give --live")
    if looks < 4 or looks % 2:
        raise ConfigError(f"--looks {looks}: an even number from 4 on, for two looks must confirm and two follow")
    found = {}
    for name in scenes.split(","):
        scene = trial(name, seed)
        with tempfile.TemporaryDirectory(prefix="ltm-update-") as folder:
            site = write_update_site(Path(folder), scene, looks, seed, layout)
            if live:
                depths, first = live_depths(site, new_log_folder(NAME), kills, domain), ""
                said = f"live, processes: {layout}{', each killed at the switch' if kills else ''}"
            else:
                depths, first = offline_depths(site)
            score = score_update(scene, site.frames, depths)
            if pictures is not None:
                pictures.mkdir(parents=True, exist_ok=True)
                (pictures / f"update_{name}.png").write_bytes(to_png(update_sheet(scene, site.frames, depths)))
        if not live:
            with tempfile.TemporaryDirectory(prefix="ltm-update-") as folder:
                again = offline_depths(write_update_site(Path(folder), scene, looks, seed, layout))[1]
            said = f"offline, {'repeats to the bit' if again == first else 'DOES NOT REPEAT'}"
        found[name] = asdict(score) | {"ratio": score.ratio, "run": said}
        typer.echo(
            f"{name}: {score.before:.2f} m before ({score.frames_before} frames), {score.after:.2f} m after "
            f"({score.frames_after}, {score.followed} to a confirmed surface), ratio {score.ratio:.2f}; {said}"
        )
    if json_path is not None:
        write_figures(json_path, {"update": found})
