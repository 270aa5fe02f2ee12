"""Take a screenshot of an .rrd file in the Rerun viewer, without a screen.

The front tab is selected in the blueprint that a running viewer reports: a nested mapping entity path -> archetype ->
field.
"""

from __future__ import annotations

import contextlib
import copy
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import cv2

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_ros.viewer.server import LOOPBACK, RerunProcess, grpc_url


def with_tab(blueprint: dict[str, Any], tab: str) -> dict[str, Any]:
    """Return a copy of the blueprint with another tab in front, by its name, ignoring case.

    Raises ConfigError that lists the tabs, if the tab does not exist.
    """
    chosen = copy.deepcopy(blueprint)
    viewport = chosen.get("/viewport", {}).get("ViewportBlueprint", {})
    root = chosen.get(f"/container/{viewport.get('root_container')}", {}).get("ContainerBlueprint", {})
    parts = root.get("contents", []) if root.get("container_kind") == "Tabs" else []
    names = {_name(chosen, part): part for part in parts}
    for name, part in names.items():
        if name.casefold() == tab.casefold():
            root["active_tab"] = part
            return chosen
    raise ConfigError(f"no tab {tab!r}; the recording has: {', '.join(names) or 'no tabs'}")


def _name(blueprint: dict[str, Any], part: str) -> str:
    """Return the name of a tab; `part` is container/ID or view/ID."""
    fields = blueprint.get(f"/{part}", {})
    named = fields.get("ContainerBlueprint") or fields.get("ViewBlueprint") or {}
    return str(named.get("display_name", part))


T = TypeVar("T")
SETTLE_S = 3.0
"""Seconds between opening and the screenshot: the viewer loads meshes and images while it draws."""


def screenshot(
    recording: Path,
    picture: Path,
    size: tuple[int, int] = (1600, 900),
    tab: str | None = None,
    timeout: float = 60.0,
) -> None:
    """Write `picture` (PNG, `size` pixels) of the last moment of `recording`, of `tab`, or of the first one.

    Needs a Vulkan driver, which may be Mesa's software one (Debian: mesa-vulkan-drivers). Raises RecordingError if the
    file cannot be opened or nothing can be drawn, ConfigError for an unknown tab.
    """
    if not recording.is_file():
        raise RecordingError(f"{recording}: no such recording")
    if picture.suffix != ".png":
        raise RecordingError(f"{picture}: the viewer writes PNG; use a name that ends in .png")
    picture.parent.mkdir(parents=True, exist_ok=True)
    picture.unlink(missing_ok=True)
    from rerun.experimental import ViewerClient

    port = _free_port()
    viewer = RerunProcess(["--headless", "--port", str(port), "--window-size", f"{size[0]}x{size[1]}"])
    try:
        viewer.wait_until_listening(port)
        client = ViewerClient.connect(grpc_url(port))
        deadline = time.monotonic() + timeout
        _retry(lambda: client.open(str(recording.resolve())), viewer, deadline, recording)
        _retry(lambda: _shown(client), viewer, deadline, recording)
        if tab is not None:
            told = _retry(client.get_blueprint, viewer, deadline, recording)
            chosen = with_tab(told.blueprint, tab)
            _retry(lambda: client.set_blueprint(chosen, of="recording"), viewer, deadline, recording)
        client.set_time(play_state="following")
        time.sleep(SETTLE_S)
        _retry(lambda: client.save_screenshot(str(picture.resolve())), viewer, deadline, recording)
    finally:
        viewer.stop()
    if cv2.imread(str(picture)) is None:
        raise RecordingError(f"{picture}: the viewer wrote no image")


def _shown(client: object) -> None:
    if not client.get_state().active_recording:  # type: ignore[attr-defined]
        raise RuntimeError("no recording is shown yet")


def _retry(action: Callable[[], T], viewer: RerunProcess, deadline: float, recording: Path) -> T:
    """Repeat a request: the viewer rejects requests until it has drawn its first frame, which is slow on
    some machines.
    """
    while True:
        try:
            return action()
        except Exception as error:
            if not viewer.running() or time.monotonic() > deadline:
                raise RecordingError(
                    f"{recording}: no image ({error}); without a screen the viewer needs a Vulkan driver (Debian: "
                    "apt-get install mesa-vulkan-drivers libgl1-mesa-dri)"
                ) from error
            time.sleep(0.2)


def _free_port() -> int:
    with contextlib.closing(socket.socket()) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
