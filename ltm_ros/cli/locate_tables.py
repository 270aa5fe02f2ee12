"""The tables of `ltm locate`."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from ltm_core.geodesy import SiteFrame
from ltm_core.locating.answer import SHARES, Answer
from ltm_core.locating.place import PlaceView


def show_answer(said: Answer, frame: SiteFrame, console: Console) -> None:
    """Print where it is, and whether the cameras agree."""
    name, posterior = said.name, said.location.posterior
    table = Table(title="smoke, its foot" if said.smoke else "on the ground", show_header=False)
    table.add_row(f"mean place, {name.crs}", f"{name.x:.1f}, {name.y:.1f}")
    x, y = posterior.likeliest
    table.add_row("likeliest place", f"{x + frame.x_origin:.1f}, {y + frame.y_origin:.1f}")
    table.add_row("longitude, latitude", f"{name.lon:.6f}, {name.lat:.6f}")
    table.add_row("MGRS", name.mgrs or "none at this latitude")
    if name.elevation is not None:
        table.add_row("elevation", f"{name.elevation:.0f} m, sigma {said.elevation_sigma:.0f} m")
    for share, ellipse in zip(SHARES, said.ellipses, strict=True):
        table.add_row(
            f"ellipse, {share:.0%}",
            f"{ellipse.major:,.0f} m by {ellipse.minor:,.0f} m (half axes), long axis {ellipse.azimuth_deg:.0f}°",
        )
    modes = posterior.modes
    if len(modes) > 1:
        parts = (
            f"{mode.share:.0%} at {mode.centre[0] + frame.x_origin:.0f}, {mode.centre[1] + frame.y_origin:.0f}"
            for mode in modes[:4]
        )
        table.add_row(f"{len(modes)} separate areas", "\n".join(parts))
    if said.smoke and said.location.lift > 1:
        table.add_row("hidden below", f"{said.location.lift:.0f} m above the ground there (mean)")
    if said.fuel is not None:
        table.add_row("fuel (prior map)", f"{said.fuel.name} ({said.fuel.code})")
    console.print(table)
    agreement = said.location.agreement
    if agreement is not None and agreement.wrong is not None:
        verdict = agreement.verdict
        turn, sigma = math.degrees(verdict.turn), math.degrees(verdict.sigma)
        left_out = agreement.suspicion[agreement.wrong]
        console.print(
            f"[yellow]The cameras disagree: {agreement.wrong} seems to be turned "
            f"({verdict.suspicion[agreement.wrong]:.0%}), its stated azimuth is {abs(turn):.1f} degrees (sigma "
            f"{sigma:.1f}) too {'great' if turn > 0 else 'small'}. It is left out of the place by {left_out:.0%}; "
            "check its pose.",
            highlight=False,
        )
    elif agreement is not None and not agreement.agree:
        shares = ", ".join(f"{camera} {share:.0%}" for camera, share in agreement.suspicion.items())
        console.print(
            f"[yellow]The cameras disagree, and which one is wrong cannot be told: {shares}.", highlight=False
        )
    console.print(views_table(said.views))


def views_table(views: Sequence[PlaceView]) -> Table:
    """What each camera has of a place."""
    table = Table("camera", "distance", "bearing", "pitch", "look", "pixel", "state", title="seen from the cameras")
    for view in views:
        state = view.state.name.lower()
        if view.hidden_by is not None:
            state += f": seen from {view.lift:.0f} m above it"
        table.add_row(
            view.camera,
            f"{view.distance / 1000:.2f} km",
            f"{view.azimuth_deg:.2f}°",
            f"{view.pitch_deg:+.2f}°",
            f"{view.hfov_deg:.0f}° wide",
            "outside" if view.pixel is None else f"{view.pixel[0]:.0f}, {view.pixel[1]:.0f}",
            state,
        )
    return table
