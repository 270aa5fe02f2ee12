"""`ltm view`: show a running graph in Rerun, or open a recorded .rrd file."""

import signal
import threading
import time
import webbrowser
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_core.storage.disk_io import require_folder

_START_S = 60.0
"""Time limit for the start of the viewer node, seconds."""


def view(
    site: Annotated[Path | None, Option(help="Site file of the running graph to show.")] = None,
    connect: Annotated[str | None, Option(help="Tower: [USER@]HOST[:PORT] (SSH), or https://HOST[:PORT].")] = None,
    token: Annotated[Path | None, Option(help="With --connect: file with the tower's token.")] = None,
    certificate: Annotated[Path | None, Option(help="With --connect: its certificate (PEM).")] = None,
    rrd: Annotated[Path | None, Option(help="Rerun recording to open instead.")] = None,
    save: Annotated[Path | None, Option(help="Also write the view to this .rrd file.")] = None,
    open_browser: Annotated[bool, Option("--browser/--no-browser", help="Open the page.")] = True,
    web_port: Annotated[int, Option(min=1, max=65535, help="TCP port of the page.")] = 9090,
    grpc_port: Annotated[int, Option(min=1, max=65535, help="TCP port of the data.")] = 9876,
) -> None:
    """Show a running graph or a recording in Rerun, or the status page of a tower elsewhere.

    Listens on loopback only; Ctrl-C ends it. A tower sends small images over one connection, at most 1 Mbit/s."""
    if [site, rrd, connect].count(None) != 2:
        raise ConfigError("give one of --site (a running graph), --rrd (a recording) and --connect (a tower)")
    if connect is not None:
        if save is not None:
            raise ConfigError("--connect shows a page: remove --save")
        from ltm_ros.runtime.web_server import bind_error
        from ltm_ros.tower.tower_mirror import TowerMirror, reached

        if error := bind_error("127.0.0.1", web_port):
            raise ConfigError(
                f"port {web_port} on 127.0.0.1 is in use ({error.strerror}): give another with --web-port"
            )
        with reached(connect, token, certificate) as reach, closing(TowerMirror(reach, web_port)) as mirror:
            _watch(mirror.url, open_browser, lambda: True)
        return
    if token is not None or certificate is not None:
        raise ConfigError("--token and --certificate identify a tower: give --connect, too")
    if save is not None:
        require_folder(save.parent, "a Rerun recording")  # the viewer finds a free name
    if site is not None:
        _show_graph(site, save, open_browser, web_port, grpc_port)
    elif rrd is not None:
        if not rrd.is_file():
            raise RecordingError(f"{rrd}: no such recording; write one with `ltm run --view` or `ltm view --save`")
        from ltm_ros.viewer.server import RerunProcess, web_url  # it needs the extra ltm[view]

        server = RerunProcess.serve(web_port, grpc_port, rrd)
        try:
            _watch(web_url(web_port, grpc_port), open_browser, server.running)
        finally:
            server.stop()


def _show_graph(path: Path, save: Path | None, open_browser: bool, web_port: int, grpc_port: int) -> None:
    from ltm_core.site.site_io import load_site
    from ltm_ros.launching.graph import Graph, ParameterValue, describe
    from ltm_ros.launching.runner import Runner
    from ltm_ros.viewer.server import listens, web_url

    site = load_site(path)
    wanted: dict[str, ParameterValue] = {"serve": True, "web_port": web_port, "grpc_port": grpc_port}
    if save is not None:
        wanted["save"] = str(save.resolve())
    # A separate name, because the graph may run a viewer that writes a file.
    node = replace(describe(site, path, view=wanted).node("viewer"), name="live_view", required=True)
    with Runner(Graph(site.name, (node,))) as runner:
        deadline = time.monotonic() + _START_S
        while not listens(web_port):
            if runner.failing or time.monotonic() > deadline:
                raise ConfigError("the viewer node could not start; its messages are above")
            time.sleep(0.1)
        _watch(web_url(web_port, grpc_port), open_browser, lambda: not runner.failing)


def _watch(url: str, open_browser: bool, running: Callable[[], bool]) -> None:
    """Open a page, and wait until what serves it ends, or SIGINT, SIGTERM or SIGHUP comes."""
    typer.echo(f"watch it at {url}\nCtrl-C ends it")
    if open_browser:
        webbrowser.open(url)
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stopping.set())
    while not stopping.wait(0.2) and running():
        pass
