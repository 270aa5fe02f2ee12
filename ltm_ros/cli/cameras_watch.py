"""`ltm cameras watch` and `ltm cameras snapshot`: watch the cameras of a graph, and take one image."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.markup import escape
from rich.table import Table

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, pose_sigmas, sigma_keys
from ltm_core.pictures import to_png
from ltm_core.pictures.trace import depth_picture, map_picture
from ltm_core.pose_estimation.mount.mount_io import append_reading
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import require_files, require_folder
from ltm_core.storage.image_io import decode_rgb
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.trace_io import GuessConfig, cell_counts, write_pose_file
from ltm_msgs_py.image import encode_rgb
from ltm_ros.cameras.camera_source import CameraSource, Frame
from ltm_ros.cameras.opening import calibration_of, direction_of, open_reader
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.cli.output import table
from ltm_ros.runtime.clocks import SystemClock
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.ros_environment import limit_shutdown

STYLES = {"alive": "green", "connecting": "cyan", "night": "blue", "moved": "cyan"}
"""Styles of the states that need no action; other states are red."""
SILENT_S = 5.0
"""Seconds without diagnostics after which a node counts as silent; diagnostics come once a second."""


class CameraWatch:
    """Subscriber to `/diagnostics` with its own ROS context."""

    def __init__(self, site: str, cameras: Sequence[str]) -> None:
        self._names = {f"/{site}/{camera}/source": camera for camera in cameras}
        self._said: dict[str, tuple[float, dict[str, str]]] = {}
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("ltm_cameras_watch", context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def listen(self, seconds: float, until_all: bool = False) -> None:
        """Listen for the given time, or until every camera has reported."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not (until_all and not self.silent()):
            self._executor.spin_once(timeout_sec=0.1)

    def states(self) -> dict[str, dict[str, str]]:
        """Return the last report of each camera; empty for silent cameras."""
        now = time.monotonic()
        found: dict[str, dict[str, str]] = {}
        for camera in self._names.values():
            at, said = self._said.get(camera, (0.0, {}))
            found[camera] = said if now - at < SILENT_S else {}
        return found

    def silent(self) -> list[str]:
        """Return the cameras that have never reported."""
        return [camera for camera in self._names.values() if camera not in self._said]

    def close(self) -> None:
        limit_shutdown()
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            camera = self._names.get(status.name)
            if camera is not None:
                self._said[camera] = time.monotonic(), {value.key: value.value for value in status.values}


def state_table(states: Mapping[str, Mapping[str, str]]) -> Table:
    """Return the table of all cameras' states."""
    rows: list[Sequence[str]] = []
    for camera, said in states.items():
        if not said:
            rows.append((camera, "[red]silent", *[""] * 6, "no report from its node: check that the graph is running"))
            continue
        state = said.get("state", "?")
        age, known = said.get("picture_age_s"), said.get("stamp_uncertainty_s")
        ahead = said.get("camera_clock_ahead_s")
        rows.append(
            (
                camera,
                f"[{STYLES.get(state, 'bold red')}]{escape(state)}",
                _since(said.get("state_since")),
                "" if age is None else f"{age} s ago",
                "" if known is None else f"+- {known} s by {escape(said.get('stamp_told_by', '?'))}",
                "" if ahead is None else f"{float(ahead):+.1f} s",
                said.get("frames_out", ""),
                said.get("dropped", ""),
                escape(said.get("state_why", "")),
            )
        )
    columns = ("camera", "state", "since (UTC)", "image", "stamps", "clock", "published", "rejected", "why")
    return table("", columns, rows)


def _since(epoch: str | None) -> str:
    if not epoch:
        return ""
    return datetime.fromtimestamp(float(epoch), UTC).strftime("%m-%d %H:%M:%S")


READINGS = "readings.csv"


def take_snapshot(
    site_file: Path, camera_name: str, out: Path, name: str, trace: bool, tries: int, overwrite: bool
) -> tuple[list[Path], list[str]]:
    """Take an image; return the written files and the lines to print. Raises ConfigError, and SourceError if no usable
    image came.
    """
    site = load_site(site_file)
    require_folder(out, "an image")
    frame, reason = _frame(site, camera_name, tries)
    if frame is None:
        raise SourceError(f"{camera_name} sent no usable image: {reason}")
    taken = datetime.fromtimestamp(frame.stamp_ns / 1e9, UTC)
    name = name or f"{camera_name}_{taken:%Y%m%dT%H%M%SZ}"
    picture = out / f"{name}.jpg"
    files = [picture]
    if frame.pose is not None:
        files += [out / f"{name}.yaml"] + ([out / f"{name}_depth.png", out / f"{name}_map.png"] if trace else [])
    require_files(files, overwrite)
    out.mkdir(parents=True, exist_ok=True)
    photo = frame.rgb if frame.jpeg is None else decode_rgb(frame.jpeg)
    assert photo is not None  # nosec B101 # tells the type checker what holds
    picture.write_bytes(frame.jpeg if frame.jpeg is not None else encode_rgb(photo, "jpeg", 95))
    told = [f"taken {taken:%Y-%m-%d %H:%M:%S} UTC +- {frame.uncertainty:.2f} s, by {frame.told_by}"]
    if frame.reading is not None:
        reading = frame.reading
        told.append(f"PTZ head: pan {reading.pan_deg:.3f}, tilt {reading.tilt_deg:.3f}, zoom {reading.zoom:g}")
        append_reading(out / READINGS, picture.name, reading.pan_deg, reading.tilt_deg, reading.zoom)
        files.append(out / READINGS)
    if frame.pose is None:
        return files, [*told, "the site file has no pose for this camera, so the image cannot be traced"]
    told.append(_pose_line(frame.pose, frame))
    notes = [f"Image of {camera_name} at {taken:%Y-%m-%dT%H:%M:%SZ}, by `ltm cameras snapshot`."]
    guess = GuessConfig.model_validate(
        {
            "pose": dict(zip("xyz", map(float, frame.pose.position), strict=True)),
            "calibration": {"width": frame.camera.width, "height": frame.camera.height, "fx": frame.camera.fx},
            "curvature": site.curvature,
            "refraction": site.refraction,
        }
    )
    sigmas = {} if frame.covariance is None else sigma_keys(frame.pose, frame.covariance)
    write_pose_file(files[1], frame.camera, frame.pose, sigmas, guess, site.frame, notes)
    if trace:
        told.append(_traced(site, site.open_dem(), frame.camera, frame.pose, photo, files[2], files[3], camera_name))
    return files, told


def _frame(site: Site, name: str, tries: int) -> tuple[Frame | None, str]:
    """Return the first usable image, or the reason why the last one was rejected."""
    camera = site.camera(name)
    if camera.source is None:
        raise ConfigError(
            f"camera {name} of site {site.name} has no section `source`, so no image can be requested from it"
        )
    clock, frames = SystemClock(), list[Frame]()
    # A snapshot at night is accepted, too.
    settings = camera.source.model_copy(update={"night": "publish"})
    source = CameraSource(
        settings,
        calibration_of(camera, name),
        # The PTZ head is only read, not moved: the site's running graph may be moving it.
        replace(direction_of(site, camera), patrol=None),
        partial(open_reader, settings, site.limits.image_bytes, clock),
        frames.append,
        Health(),
        clock,
    )
    why = ""
    try:
        for _ in range(tries):
            pause = source.step()
            if frames:
                return frames[0], ""
            why = f"{source.record.latest}: {source.record.why}"
            if source.record.latest in ("unauthorised", "stalled"):
                break
            time.sleep(min(pause, 1.0))
    finally:
        source.close()
    return None, why


def _pose_line(pose: Pose, frame: Frame) -> str:
    azimuth, pitch, roll = pose.angles_deg
    line = f"viewing direction: azimuth {azimuth:.2f}, pitch {pitch:+.2f}, roll {roll:+.2f} deg"
    if frame.covariance is not None:
        sigmas = pose_sigmas(pose, frame.covariance)[3:]
        line += f" (sigmas {', '.join(f'{sigma:.2f}' for sigma in sigmas)})"
    return f"{line}; field of view {frame.camera.hfov_deg:.1f} deg"


def _traced(
    site: Site, dem: Dem, camera: Camera, pose: Pose, photo: UInt8Array, depth: Path, on_map: Path, name: str
) -> str:
    traced = TerrainTracer(dem, site.curvature, site.refraction, site.possible_ground).trace(camera, pose)
    depth.write_bytes(to_png(depth_picture(traced, dem, photo)))
    on_map.write_bytes(to_png(map_picture(traced, dem, cell_counts(traced), f"seen by {name}", site.frame)))
    ranges = traced.range
    known = ranges[np.isfinite(ranges)]
    if not known.size:
        return "no pixel sees the terrain: check the pose"
    share = np.isfinite(ranges).mean()
    return f"{share:.0%} of the pixels see terrain, {known.min():,.0f} to {known.max():,.0f} m away"
