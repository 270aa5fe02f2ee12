"""`ltm-lab bench sources`: what asking many cameras costs, and how true the stamps are."""

from __future__ import annotations

from typing import Annotated

import typer

from ltm_lab.cli.bench.runs import print_conditions, write_runs
from ltm_ros.cli.output import JsonFile


def sources(
    cameras: Annotated[int, typer.Option(help="HTTP cameras, on this machine.", min=1)] = 24,
    every: Annotated[float, typer.Option(help="Seconds between two snapshots of a camera.", min=0.1)] = 10.0,
    seconds: Annotated[float, typer.Option(help="For which it is measured.", min=1)] = 120.0,
    width: Annotated[int, typer.Option(help="Of the pictures, pixels.", min=64)] = 1920,
    ahead: Annotated[float, typer.Option(help="Seconds by which the cameras' clock is wrong.")] = 37.0,
    rtsp: Annotated[str, typer.Option(help="Instead: read this stream, all its pictures and its key frames.")] = "",
    domain: Annotated[int | None, typer.Option(help="ROS domain.", min=0, max=232)] = None,
    json_path: JsonFile = None,
) -> None:
    """Run the process that asks a site's cameras, on HTTP cameras whose clock is wrong; or read an RTSP stream."""
    from dataclasses import asdict

    from rich.console import Console

    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.sources import run_sources, run_stream

    console = Console()
    state = conditions(("httpx", "numpy", "opencv-python-headless"))
    print_conditions(console, state)
    if rtsp:
        streams = [run_stream(rtsp, frames, seconds) for frames in ("all", "key")]
        for stream in streams:
            console.print(
                f"{stream.frames} frames, {stream.size[0]} x {stream.size[1]}: {stream.pictures} in "
                f"{stream.seconds:.0f} s, {stream.cores:.1%} of a core, {stream.state}",
                highlight=False,
            )
        if json_path is not None:
            write_runs(json_path, state, [asdict(stream) for stream in streams])
        return
    with console.status("asking"):
        result = run_sources(cameras, every, seconds, width, ahead, domain)
    console.print(
        f"{result.cameras} cameras, a snapshot of {result.picture_kb:.0f} kB each {result.every:g} s: "
        f"{result.pictures} came in {result.seconds:.0f} s, {result.cores:.1%} of a core, "
        f"{result.cpu_ms_each:.1f} ms a picture, {result.pss_mb:.0f} MB, {result.threads} threads",
        highlight=False,
    )
    console.print(
        f"clock wrong by {ahead:g} s: {len(result.errors)} stamps of one camera, off by {result.median_s:.3f} s in the "
        f"median, {result.p95_s:.3f} s at 95 %; what was told held for {result.held:.0%}",
        highlight=False,
    )
    if json_path is not None:
        write_runs(json_path, state, [asdict(result)])
