"""What a node's diagnostics say of a camera's pictures: which are used, and why others are not."""

from __future__ import annotations

from ltm_core.vision.scene_view import SceneView
from ltm_ros.runtime.health import Health


def note_picture(health: Health, seen: SceneView) -> None:
    """Count a picture that is not used by its reason, and say how the last one was."""
    if seen.reason is not None:
        health.note(f"unusable.{seen.reason}")
    if seen.smoke > 0:
        health.note("smoke")
    smoke = "" if seen.smoke == 0 else f"usable but for {seen.smoke:.1%}, smoke before the land"
    doubtful = "" if seen.doubtful is None else f"usable but for {seen.doubtful.mean():.0%}, burnt out or black"
    if seen.masked:
        health.gauge("mask", seen.masked)
    health.gauge("picture", seen.unusable or smoke or doubtful or "usable")
