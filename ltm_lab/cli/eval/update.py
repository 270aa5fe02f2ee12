"""`ltm-lab eval update`: test whether traced depth follows the surface that several views have confirmed."""

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.options import JsonFile, writable_folder


def update(
    scenes: Annotated[str, typer.Option(help="Scenes of `ltm-lab eval terrain`.")] = "felled,burn",
    seed: Annotated[int, typer.Option(help="Seed of ground, plants and noise.")] = 23,
    looks: Annotated[int, typer.Option(help="Frames of each tower, two hours apart; an even number.", min=4)] = 4,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for an image of each scene.", callback=writable_folder)
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Compare the median error of traced depth on changed ground before and after the surface is confirmed.

    The towers' depth is that of a known surface with noise; poses are exact. Each scene is run twice; the command ends
    with status 1 if the runs differ. Separate several scenes with commas.
    """
    import tempfile
    from dataclasses import asdict

    from ltm_core.base.errors import ConfigError
    from ltm_core.pictures import to_png
    from ltm_lab.evaluation.pictures.figure import picture_of
    from ltm_lab.evaluation.terrain.hillside_scenes import trial
    from ltm_lab.evaluation.update_trial import offline_depths, score_update, update_figure, write_update_site
    from ltm_ros.pages import write_figures

    if looks % 2:
        raise ConfigError(f"--looks {looks} is odd; give an even number, half for each side of the confirmation")
    found = {}
    for name in scenes.split(","):
        scene, digests = trial(name, seed), set[str]()
        for _ in range(2):
            with tempfile.TemporaryDirectory(prefix="ltm-update-") as folder:
                site = write_update_site(Path(folder), scene, looks, seed)
                depths, digest = offline_depths(site)
                digests.add(digest)
        score, repeats = score_update(scene, site.frames, depths), len(digests) == 1
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            sheet = picture_of(update_figure(scene, site.frames, depths))
            (pictures / f"update_{name}.png").write_bytes(to_png(sheet))
        found[name] = asdict(score) | {"ratio": score.ratio, "repeats": repeats}
        typer.echo(
            f"{name}: {score.before:.2f} m before ({score.frames_before} frames), {score.after:.2f} m after "
            f"({score.frames_after}, {score.followed} to a confirmed surface), ratio {score.ratio:.2f}; "
            f"{'both runs are identical' if repeats else 'THE RUNS DIFFER'}"
        )
    if json_path is not None:
        write_figures(json_path, {"update": found})
    raise typer.Exit(0 if all(one["repeats"] for one in found.values()) else 1)
