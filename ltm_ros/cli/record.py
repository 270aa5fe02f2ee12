"""`ltm record`, `ltm replay` and `ltm import`: record a running graph, replay a recording, and make one from photos."""

import threading
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from ltm_core.base.errors import ConfigError
from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import require_files, require_folder
from ltm_msgs_py.bag.writer import BagWriter
from ltm_ros.cli.output import (
    Domain,
    Overwrite,
    Row,
    outcome,
    print_nodes,
    print_table,
    progress_bar,
    say,
    stop_on_signals,
    warn,
)
from ltm_ros.launching.graph import Graph, ParameterValue, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.recordings.replay import LONGEST_PAUSE
from ltm_ros.recordings.replay.offline import require_frames, require_whole
from ltm_ros.runtime.health import node_rows


def record(
    site: Annotated[Path, Option(help="Site file.")],
    out: Annotated[Path, Option("--out", "-o", help="Bag folder to write.")],
    topics: Annotated[list[str] | None, Argument(help="Topics or patterns; default: inputs and results.")] = None,
    max_gb: Annotated[float | None, Option(min=0, help="Maximum GB of a name's recordings; 0: unlimited.")] = None,
    min_free_gb: Annotated[float | None, Option(min=0, help="Free GB below which recording stops.")] = None,
    sim_time: Annotated[bool, Option("--sim-time", help="Use /clock for stamps, as during a replay.")] = False,
    domain: Domain = None,
) -> None:
    """Record a site's topics to OUT until Ctrl-C. Long recordings keep the newest files (--max-gb).

    Defaults: the site file's values, else at most 16 GB or half of the disk, and 2 GB or a tenth of it left free."""
    parameters: dict[str, ParameterValue] = {"bag": str(out.resolve())}
    for name, gigabytes in (("max_bytes", max_gb), ("min_free_bytes", min_free_gb)):
        if gigabytes is not None:
            parameters[name] = round(gigabytes * 1e9)
    if topics:
        parameters["topics"] = list(topics)
    require_folder(out, "a bag")  # the recorder checks the folders of earlier recordings itself
    config = load_site(site)
    whole = describe(config, site, sim_time=sim_time, record=parameters)
    # With `ltm run`, the recorder is an extra; here it is the only node.
    graph = Graph(config.name, (replace(whole.node("recorder"), required=True),))
    raise typer.Exit(Runner(graph, domain_id=domain).run())


def replay(
    bag: Annotated[Path, Argument(help="Bag folder, or .mcap, .mcap.zstd or .db3 file.")],
    site: Annotated[Path | None, Option(help="Site file. Default: site.yaml in or beside the bag.")] = None,
    out: Annotated[Path, Option("--out", "-o", help="Folder for the results.")] = Path("out/replay"),
    remap: Annotated[list[str] | None, Option(metavar="RECORDED:=NAME", help="Read a topic as another one.")] = None,
    offline: Annotated[bool, Option("--offline", help="Replay in one process, fast and bit-repeatable.")] = False,
    rate: Annotated[float, Option(help="Live: playback rate; 2 is twice as fast.")] = 1.0,
    longest_pause: Annotated[float, Option(help="Live: skip longer pauses, in seconds. inf: never.")] = LONGEST_PAUSE,
    loop: Annotated[bool, Option("--loop", help="Live: repeat until Ctrl-C.")] = False,
    start: Annotated[float, Option(min=0, help="Start, in seconds into the recording.")] = 0.0,
    duration: Annotated[float | None, Option(min=0, help="Duration to play, in seconds.")] = None,
    record: Annotated[bool, Option("--record", help="Also write a bag of the results.")] = False,
    rrd: Annotated[bool, Option("--rrd", help="Live: also write a Rerun recording.")] = False,
    domain: Domain = None,
    publish_only: Annotated[bool, Option("--publish-only", help="Live: publish to a graph with sim time.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Replay BAG through the graph of SITE and write its fuel map to OUT/fuel_map.tif."""
    if offline and (loop or rrd or publish_only or rate != 1.0):
        raise ConfigError("--offline ignores time: remove --rate, --loop, --rrd and --publish-only")
    from ltm_ros.recordings.recorded_run import site_of
    from ltm_ros.recordings.replay.run import ReplayOptions, publish, run_live, run_offline

    site = site or site_of(bag)
    names = _names(remap or [])
    rrd_file = out / "replay.rrd" if rrd else None
    options = ReplayOptions(
        start,
        duration,
        export=out / "fuel_map.tif",
        record=out / "bag" if record else None,
        rrd=rrd_file,
        rate=rate,
        longest_pause=longest_pause,
        loop=loop,
        domain_id=domain,
        names=names,
    )
    stopping = threading.Event()
    if publish_only:
        with stop_on_signals(stopping), progress_bar("replay", loops=True) as progress:
            require_whole(bag, publish(bag, site, options, progress, stopping.is_set))
        return
    require_files([out / "fuel_map.tif", *([rrd_file] if rrd_file else [])], overwrite)
    checked = load_site(site)
    if record:
        if (out / "bag").resolve() in (bag.resolve(), bag.resolve().parent):
            raise ConfigError(f"{out / 'bag'} is the recording to replay; give another --out")
        BagWriter.require_free(out / "bag", overwrite)
    out.mkdir(parents=True, exist_ok=True)
    with progress_bar("replay", loops=True) as progress:
        if offline:
            summaries = run_offline(bag, site, options, progress)
        else:
            with stop_on_signals(stopping):
                summaries = run_live(bag, site, options, progress, say, stopping.is_set)
    print_nodes(node_rows(summaries))
    if results := outcome(summaries):
        print_table("results", ("", ""), results)
    if not stopping.is_set():
        require_frames(bag, checked, summaries, names)
    say(f"fuel map: {out / 'fuel_map.tif'}")
    require_whole(bag, summaries)


def _names(remap: list[str]) -> dict[str, str]:
    """Return the names of `--remap`, by recorded topic. Raises ConfigError."""
    names = dict(text.partition(":=")[::2] for text in remap)
    for topic, name in names.items():
        if not topic.startswith("/") or not name.startswith("/"):
            raise ConfigError(f"--remap {topic}:={name}: give two absolute topics, such as /odom:=/ridge/north/pose")
    return names


def import_(
    images: Annotated[list[Path], Argument(metavar="PHOTOS", help="Photo, folder, or Sensor Logger recording.")],
    out: Annotated[Path, Option("--out", help="Bag folder to write.")],
    poses: Annotated[Path | None, Option("--poses", help="CSV, or folder of pose files; they override EXIF.")] = None,
    site: Annotated[Path | None, Option(help="Site file: map frame, DEM, camera names.")] = None,
    camera: Annotated[str | None, Option(help="Camera that took the photos.")] = None,
    pitch_deg: Annotated[float | None, Option(help="Pitch in degrees if unknown. Default: rejected.")] = None,
    height_above_ground: Annotated[float, Option(min=0, help="Height in metres of photos without one.")] = 2.0,
    start_height: Annotated[float | None, Option(help="Height in metres at a barometer's start; else ground.")] = None,
    geoid_undulation_m: Annotated[float | None, Option(help="Geoid above ellipsoid in metres (GPS altitudes).")] = None,
    focal_35mm: Annotated[float | None, Option(min=1, help="Focal length in mm (35 mm) if unknown.")] = None,
    time_zone: Annotated[str | None, Option(help="Time zone of EXIF dates without one, such as Europe/Oslo.")] = None,
    refine: Annotated[bool, Option("--refine", help="Find poses by the terrain's skyline; needs --site.")] = False,
    skip_bad: Annotated[bool, Option("--skip-bad", help="Skip photos that cannot be imported.")] = False,
) -> None:
    """Make a bag from photos and phone recordings: image_raw/compressed, camera_info, pose with covariance."""
    from ltm_ros.recordings.importing.assumptions import Assumptions
    from ltm_ros.recordings.importing.assumptions import time_zone as zone_named
    from ltm_ros.recordings.importing.build import import_photos
    from ltm_ros.recordings.importing.refinement import PoseRefinement

    place = load_site(site) if site is not None else None
    search = None
    if refine:
        if place is None:
            raise ConfigError("--refine needs terrain: give the site that has the DEM, with --site")
        search = PoseRefinement(place)
    assumptions = Assumptions(
        pitch_deg,
        height_above_ground=height_above_ground,
        geoid_undulation=geoid_undulation_m,
        time_zone=None if time_zone is None else zone_named(time_zone),
        keep_unknown=refine,
        start_height=start_height,
        focal_35mm=focal_35mm,
    )
    with progress_bar("importing photos") as progress:
        report = import_photos(images, out, poses, place, camera, assumptions, skip_bad, progress, search)
    for note, names in _grouped((note, name) for name, note in report.notes).items():
        warn(f"{names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}: {note}")
    if report.refined:
        rows = []
        for name, found in report.refined:
            turned = ", ".join(f"{angle:+.2f}" for angle in found.turned_deg)
            rows.append((name, found.verdict, turned if any(found.turned_deg) else "unchanged"))
        print_table("poses", ("photo", "verdict", "rotation in azimuth, pitch, roll, deg"), rows)
        verdicts = [found.verdict for _, found in report.refined]
        said = f"{verdicts.count('accepted')} of {len(verdicts)} poses found in the photos"
        if "as_others" in verdicts:
            said += f"; {verdicts.count('as_others')} corrected by the compass error on which these agree"
        say(said)
    if site is None:
        say(f"frame: {report.crs}, origin {report.origin}; a site file for it needs a DEM in that CRS")
    files: list[Row] = [
        ("imported", str(count), f"/{report.site}/{name}/{{image_raw/compressed, camera_info, pose}}")
        for name, count in report.cameras.items()
    ]
    files += [(("red", "rejected"), "1", why) for _, why in report.rejected]
    for why, names in _grouped((skipped.why, skipped.path.name) for skipped in report.skipped).items():
        others = ", ..." if len(names) > 3 else ""
        files.append((("yellow", "skipped"), str(len(names)), f"{why} ({', '.join(names[:3])}{others})"))
    print_table(str(report.bag), ("result", ">files", "topics or reason"), files)


def _grouped(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Return the second values by the first ones, in order."""
    found: dict[str, list[str]] = {}
    for key, value in pairs:
        found.setdefault(key, []).append(value)
    return found
