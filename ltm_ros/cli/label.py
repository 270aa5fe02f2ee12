"""`ltm label`: a page in the browser on which to name areas in photos."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def label(
    folder: Annotated[Path, typer.Argument(help="Folder of photos; polygons.json and NAME_labels.png go there.")],
    model: Annotated[
        str, typer.Option(help="Segmentation network whose answer is a start; none: no network. Default: the shipped.")
    ] = "",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of this machine alone; 0: a free one.")] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
) -> None:
    """Name areas in photos with polygons and a brush, on a page that only this machine and this link reach.

    Ends with Ctrl-C; each photo is written when it is left, or with Ctrl-S.
    """
    import threading
    import webbrowser

    from ltm_core.base.errors import ConfigError
    from ltm_core.storage.disk_io import require_folder
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_ros.labelling.server import LabelServer
    from ltm_ros.labelling.session import LabelSession

    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder")
    require_folder(folder)
    session = LabelSession(folder, None if model == "none" else Segmenter.open(model or DEFAULT_MODEL))
    try:
        server = LabelServer(session, port)
    except OSError as error:
        raise ConfigError(f"--port {port}: cannot be used ({error.strerror}); 0 takes a free one") from error
    typer.echo(f"{server.url}\nCtrl-C ends it")
    if browser:
        webbrowser.open(server.url)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        typer.echo("ended")
    finally:
        server.close()
