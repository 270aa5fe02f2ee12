"""`ltm import`: make a recording from photos and videos, using EXIF, phone sensors or a pose file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import print_table


def import_(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="PHOTOS...",
            help="Photo, video, folder, or Sensor Logger recording.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Bag folder to write.")],
    poses: Annotated[
        Path | None,
        typer.Option(
            "--poses",
            help="CSV or YAML (name, x y z or lon lat, azimuth_deg, fx, ...), or a folder of pose files. "
            "Overrides EXIF.",
        ),
    ] = None,
    site: Annotated[Path | None, typer.Option("--site", help="Site file: map frame, DEM, camera names.")] = None,
    camera: Annotated[str | None, typer.Option("--camera", help="Camera that took the photos.")] = None,
    pitch_deg: Annotated[
        float | None, typer.Option(help="Pitch in degrees of photos without one. Default: reject them.")
    ] = None,
    height_above_ground: Annotated[float, typer.Option(min=0, help="Height in metres of photos without one.")] = 2.0,
    start_height: Annotated[
        float | None,
        typer.Option(help="Height (DEM datum, metres) at a barometer's start. Default: the terrain's."),
    ] = None,
    geoid_undulation_m: Annotated[
        float | None,
        typer.Option(help="Geoid height above ellipsoid in metres, for ellipsoidal altitudes (then also EXIF's)."),
    ] = None,
    focal_35mm: Annotated[
        float | None,
        typer.Option("--focal-35mm", min=1, help="Focal length of photos without one, in mm (35 mm equivalent)."),
    ] = None,
    every: Annotated[float, typer.Option(min=0.01, help="Seconds between the frames taken from a video.")] = 1.0,
    time_zone: Annotated[
        str | None, typer.Option(help="Time zone of EXIF dates without one, such as Europe/Oslo.")
    ] = None,
    write_photos: Annotated[
        Path | None,
        typer.Option(help="Also write upright photos and poses.csv for `ltm pose photo`."),
    ] = None,
    refine: Annotated[
        bool,
        typer.Option("--refine", help="Find the pose of each photo by the terrain's skyline; needs --site."),
    ] = False,
    skip_bad: Annotated[bool, typer.Option("--skip-bad", help="Skip photos that cannot be imported.")] = False,
) -> None:
    """Make a bag from photos and phone recordings: image_raw/compressed, camera_info, pose with covariance."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from ltm_core.base.errors import ConfigError
    from ltm_core.site.site_io import load_site
    from ltm_ros.recordings.importing.assumptions import Assumptions
    from ltm_ros.recordings.importing.assumptions import time_zone as zone_named
    from ltm_ros.recordings.importing.build import import_photos
    from ltm_ros.recordings.importing.refinement import PoseRefinement

    zone = zone_named(time_zone) if time_zone is not None else None
    place = load_site(site) if site is not None else None
    search = None
    if refine:
        if place is None:
            raise ConfigError("--refine needs terrain: give the site that has the DEM, with --site")
        search = PoseRefinement(place)
    console = Console()
    columns = (TextColumn("Importing photos"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("import", total=None)
        report = import_photos(
            images,
            out,
            poses,
            place,
            camera,
            Assumptions(
                pitch_deg,
                height_above_ground=height_above_ground,
                geoid_undulation=geoid_undulation_m,
                time_zone=zone,
                keep_unknown=refine or write_photos is not None,
                start_height=start_height,
                focal_35mm=focal_35mm,
                every=every,
            ),
            skip_bad,
            lambda done, total: bar.update(task, completed=done, total=total),
            write_photos,
            search,
        )
    by_note: dict[str, list[str]] = {}
    for name, note in report.notes:
        by_note.setdefault(note, []).append(name)
    for note, names in by_note.items():
        others = f" and {len(names) - 1} more" if len(names) > 1 else ""
        console.print(f"[yellow]{names[0]}{others}: {note}", highlight=False)
    if report.refined:
        rows = []
        for name, found in report.refined:
            turned = ", ".join(f"{angle:+.2f}" for angle in found.turned_deg)
            rows.append((name, found.verdict, turned if any(found.turned_deg) else "unchanged"))
        print_table(console, "poses", ("photo", "verdict", "rotation in azimuth, pitch, roll, deg"), rows)
        verdicts = [found.verdict for _, found in report.refined]
        said = f"{verdicts.count('accepted')} of {len(verdicts)} poses found in the photos"
        if "as_others" in verdicts:
            said += f"; {verdicts.count('as_others')} corrected by the compass error on which these agree"
        console.print(said, highlight=False)
    if site is None:
        console.print(f"frame: {report.crs}, origin {report.origin}; a site file for it needs a DEM in that CRS")
    files = [
        ("imported", str(count), f"/{report.site}/{name}/{{image_raw/compressed, camera_info, pose}}")
        for name, count in report.cameras.items()
    ]
    files += [("[red]rejected", "1", escape(why)) for _, why in report.rejected]
    by_reason: dict[str, list[str]] = {}
    for skipped in report.skipped:
        by_reason.setdefault(skipped.why, []).append(skipped.path.name)
    for why, names in by_reason.items():
        others = ", ..." if len(names) > 3 else ""
        files.append(("[yellow]skipped", str(len(names)), escape(f"{why} ({', '.join(names[:3])}{others})")))
    print_table(console, str(report.bag), ("result", ">files", "topics or reason"), files)
