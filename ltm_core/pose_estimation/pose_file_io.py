"""Reads what is known of a pose before it is found, and writes what was found, as pose files of `ltm trace`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from ltm_core.camera import Camera
from ltm_core.geodesy import SiteFrame
from ltm_core.pose import Pose
from ltm_core.tracing.trace_io import PoseFile


class GuessConfig(PoseFile):
    """What is known of a camera before its pose is found: a pose file whose angles may be left out.

    The position is held, or is where the search starts. Without `azimuth_deg` all directions are searched.
    """


def write_pose_file(
    path: Path | str,
    camera: Camera,
    pose: Pose,
    sigmas: Mapping[str, float],
    guess: GuessConfig,
    frame: SiteFrame,
    notes: Sequence[str],
) -> None:
    """Write a pose file that `ltm trace` reads. `sigmas`: by the keys of a pose file; `notes`: comments at its top."""
    x, y, z = (float(v) for v in pose.position)
    azimuth, pitch, roll = pose.angles_deg
    k1, k2, p1, p2, k3 = (float(k) for k in camera.distortion)
    content = {
        "pose": {
            "x": round(x + frame.x_origin, 4),
            "y": round(y + frame.y_origin, 4),
            "z": round(z, 4),
            "crs": frame.crs,
            "azimuth_deg": round(azimuth, 6),
            "pitch_deg": round(pitch, 6),
            "roll_deg": round(roll, 6),
            **sigmas,
        },
        "calibration": {
            "width": camera.width,
            "height": camera.height,
            "fx": round(float(camera.fx), 4),
            "fy": round(float(camera.fy), 4),
            "cx": camera.cx,
            "cy": camera.cy,
            **{"k1": k1, "k2": k2, "p1": p1, "p2": p2, "k3": k3},
        },
        "curvature": guess.curvature,
        "refraction": guess.refraction,
    }
    head = "".join(f"# {note}\n" for note in notes)
    Path(path).write_text(head + yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
