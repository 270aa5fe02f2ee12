"""`ltm import`: makes a recording from photos, by EXIF, a phone's recording of its sensors, or a pose file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import print_table


def import_(
    images: Annotated[
        list[Path],
        typer.Option(
            "--images",
            help="Photo (JPEG, PNG, HEIC), video (MP4, MOV), folder of them, or recording of Sensor Logger, Stray "
            "Scanner or Record3D. Repeatable.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Bag folder to write.")],
    poses: Annotated[
        Path | None,
        typer.Option(
            "--poses",
            help="CSV or YAML: name, x y z or lon lat, azimuth_deg, fx, ...; or a folder of pose files. Before EXIF.",
        ),
    ] = None,
    site: Annotated[Path | None, typer.Option("--site", help="Site file: frame, DEM, camera names.")] = None,
    camera: Annotated[str | None, typer.Option("--camera", help="Camera that took the photos.")] = None,
    pitch_deg: Annotated[
        float | None, typer.Option(help="Pitch of photos without one (EXIF has none); else they are refused.")
    ] = None,
    keep_unknown: Annotated[
        bool,
        typer.Option(
            "--keep-unknown",
            help="Take photos of unknown direction or pitch as such: nothing is placed by them until a pose is found.",
        ),
    ] = False,
    roll_deg: Annotated[float, typer.Option(help="Roll of photos without one; EXIF has none.")] = 0.0,
    height_above_ground: Annotated[float, typer.Option(min=0, help="Metres, where no height is known.")] = 2.0,
    start_height: Annotated[
        float | None,
        typer.Option(help="Metres in the DEM's datum at which a barometer's record begins; else by the terrain."),
    ] = None,
    geoid_undulation_m: Annotated[
        float | None,
        typer.Option(help="Geoid above ellipsoid, metres, for ellipsoidal altitudes; EXIF's are then taken as such."),
    ] = None,
    sensor_width_mm: Annotated[
        float | None, typer.Option(min=0.1, help="Long side of the sensor, for EXIF focal lengths in mm.")
    ] = None,
    focal_35mm: Annotated[
        float | None, typer.Option("--focal-35mm", min=1, help="Of photos that state none, as on 36 mm wide film.")
    ] = None,
    every: Annotated[float, typer.Option(min=0.01, help="Seconds from one frame of a video to the next.")] = 1.0,
    time_zone: Annotated[
        str | None, typer.Option(help="Of EXIF dates that state none and have no GPS stamp, as Europe/Oslo.")
    ] = None,
    gps_sigma: Annotated[float, typer.Option(min=0.01, help="Metres, of positions that state no error.")] = 5.0,
    compass_sigma_deg: Annotated[
        float,
        typer.Option(
            min=0.01, help="Of directions that state no error; a phone's compass is 5.5 degrees off in the median."
        ),
    ] = 8.2,
    tilt_sigma_deg: Annotated[float, typer.Option(min=0.01, help="Of an assumed pitch or roll.")] = 3.0,
    write_photos: Annotated[
        Path | None,
        typer.Option(help="Also write the upright photos and poses.csv of what is known, for `ltm pose --photo`."),
    ] = None,
    refine: Annotated[
        bool,
        typer.Option("--refine", help="Find each photo's pose in its picture, by the site's terrain; needs --site."),
    ] = False,
    skip_bad: Annotated[bool, typer.Option("--skip-bad", help="Leave out photos that cannot be taken.")] = False,
) -> None:
    """Make a bag from photos and recordings of phones: image_raw/compressed, camera_info and pose with covariance."""
    from rich.console import Console
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
            raise ConfigError("--refine lays photos on terrain: name the site that has the DEM, with --site")
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
                roll_deg,
                height_above_ground,
                geoid_undulation_m,
                sensor_width_mm,
                zone,
                gps_sigma,
                compass_sigma_deg=compass_sigma_deg,
                tilt_sigma_deg=tilt_sigma_deg,
                keep_unknown=keep_unknown,
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
    for file, why in report.skipped:
        console.print(f"[red]left out {file.name}: {why}", highlight=False)
    if report.refined:
        rows = []
        for name, found in report.refined:
            turned = ", ".join(f"{angle:+.2f}" for angle in found.turned_deg)
            rows.append((name, found.verdict, turned if any(found.turned_deg) else "stays as given"))
        print_table(console, "poses", ("photo", "verdict", "turned by azimuth, pitch, roll, deg"), rows)
        verdicts = [found.verdict for _, found in report.refined]
        said = f"{verdicts.count('accepted')} of {len(verdicts)} poses found in the pictures"
        if "as_others" in verdicts:
            said += f"; {verdicts.count('as_others')} turned by the compass error that these agree on"
        console.print(said, highlight=False)
    topics = (
        (f"/{report.site}/{name}/{{image_raw/compressed, camera_info, pose}}", str(count))
        for name, count in report.cameras.items()
    )
    print_table(console, str(report.bag), ("topics", ">photos"), topics)
    if site is None:
        console.print(f"frame: {report.crs}, origin {report.origin}; a site file for it needs a DEM in that CRS")
