"""`ltm view`: show a running graph in Rerun, or open a recorded .rrd file."""

from __future__ import annotations

import signal
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_core.storage.disk_io import require_folder

if TYPE_CHECKING:
    from ltm_ros.launching.runner import Runner
    from ltm_ros.viewer.server import RerunProcess


def view(
    site: Annotated[Path | None, Option("--site", help="Site file of the running graph to show.")] = None,
    connect: Annotated[
        str | None,
        Option("--connect", help="Tower to show: [USER@]HOST[:PORT] through SSH, or https://HOST[:PORT]."),
    ] = None,
    token: Annotated[Path | None, Option("--token", help="With --connect: file with the tower's token.")] = None,
    certificate: Annotated[
        Path | None, Option("--certificate", help="With --connect: the tower's certificate (PEM).")
    ] = None,
    rrd: Annotated[Path | None, Option("--rrd", help="Rerun recording to open instead.")] = None,
    save: Annotated[Path | None, Option("--save", help="Also write the view to this .rrd file.")] = None,
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
        _show_tower(connect, token, certificate, open_browser, web_port)
        return
    if token is not None or certificate is not None:
        raise ConfigError("--token and --certificate identify a tower: give --connect, too")
    if save is not None:
        require_folder(save.parent, "a Rerun recording")  # the viewer finds a free name
    if rrd is not None:
        if not rrd.is_file():
            raise RecordingError(f"{rrd}: no such recording; write one with `ltm run --view` or `ltm view --save`")
        _show_file(rrd, open_browser, web_port, grpc_port)
        return
    assert site is not None  # nosec B101 # tells the type checker what holds
    _show_graph(site, save, open_browser, web_port, grpc_port)


def _show_tower(tower: str, token: Path | None, certificate: Path | None, open_browser: bool, web_port: int) -> None:
    from contextlib import closing

    from ltm_ros.runtime.web_server import bind_error
    from ltm_ros.tower.tower_mirror import TowerMirror, reached

    if error := bind_error("127.0.0.1", web_port):
        raise ConfigError(f"port {web_port} on 127.0.0.1 is in use ({error.strerror}): give another with --web-port")
    with reached(tower, token, certificate) as reach, closing(TowerMirror(reach, web_port)) as mirror:
        _announce(mirror.url, open_browser)
        _until_ended(None)


def _show_file(rrd: Path, open_browser: bool, web_port: int, grpc_port: int) -> None:
    from ltm_ros.viewer.server import RerunProcess, web_url

    server = RerunProcess.serve(web_port, grpc_port, rrd)
    _announce(web_url(web_port, grpc_port), open_browser)
    _until_ended(server)


def _show_graph(path: Path, save: Path | None, open_browser: bool, web_port: int, grpc_port: int) -> None:
    from dataclasses import replace

    from ltm_core.site.site_io import load_site
    from ltm_ros.launching.graph import Graph, ParameterValue, describe
    from ltm_ros.launching.runner import Runner
    from ltm_ros.viewer.server import web_url

    site = load_site(path)
    wanted: dict[str, ParameterValue] = {"serve": True, "web_port": web_port, "grpc_port": grpc_port}
    if save is not None:
        wanted["save"] = str(save.resolve())
    # A separate name, because the graph may run a viewer that writes a file.
    node = replace(describe(site, path, view=wanted).node("viewer"), name="live_view", required=True)
    with Runner(Graph(site.name, (node,))) as runner:
        if not _comes_up(runner, web_port):
            raise ConfigError("the viewer node could not start; its messages are above")
        _announce(web_url(web_port, grpc_port), open_browser)
        _until_ended(None, runner)


def _comes_up(runner: Runner, port: int, timeout: float = 60.0) -> bool:
    from ltm_ros.viewer.server import listens

    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline and not runner.given_up:
        if listens(port):
            return True
        time.sleep(0.1)
    return False


def _until_ended(process: RerunProcess | None, runner: Runner | None = None) -> None:
    """Wait until the viewer closes, its node fails, or SIGINT, SIGTERM or SIGHUP comes; then end the viewer."""
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stopping.set())
    try:
        while not stopping.wait(0.2):
            if (process is not None and not process.running()) or (runner is not None and runner.given_up):
                break
    finally:
        if process is not None:
            process.stop()


def _announce(url: str, open_browser: bool) -> None:
    import webbrowser

    typer.echo(f"watch it at {url}\nCtrl-C ends it")
    if open_browser:
        webbrowser.open(url)
