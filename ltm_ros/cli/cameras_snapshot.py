"""`ltm cameras snapshot`: take one image with its pose."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from pathlib import Path

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.pose import Pose, pose_sigmas, sigma_keys
from ltm_core.pose_estimation.mount.mount_io import append_reading
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import require_files, require_folder
from ltm_core.tracing.trace_io import GuessConfig, write_pose_file
from ltm_msgs_py.image import encode_rgb
from ltm_ros.cameras.camera_source import Frame
from ltm_ros.cameras.opening import source_of
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.runtime.health import Health

READINGS = "readings.csv"


def take_snapshot(
    site_file: Path, camera_name: str, out: Path, name: str, tries: int, overwrite: bool
) -> tuple[list[Path], list[str]]:
    """Take an image; return the written files and the lines to print. Raises ConfigError, and SourceError if no usable
    image came."""
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
        files.append(out / f"{name}.yaml")
    require_files(files, overwrite)
    out.mkdir(parents=True, exist_ok=True)
    if frame.rgb is not None and frame.jpeg is None:
        picture.write_bytes(encode_rgb(frame.rgb, "jpeg", 95))
    else:
        picture.write_bytes(frame.jpeg or b"")
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
    return files, told


def _frame(site: Site, name: str, tries: int) -> tuple[Frame | None, str]:
    """Return the first usable image, or the reason why the last one was rejected."""
    camera = site.camera(name)
    if camera.source is None:
        raise ConfigError(
            f"camera {name} of site {site.name} has no section `source`, so no image can be requested from it"
        )
    frames = list[Frame]()
    # A snapshot at night is accepted, too.
    settings = camera.source.model_copy(update={"night": "publish"})
    source = source_of(site, name, settings, frames.append, Health())
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
