"""Define the layout (blueprint) of the Rerun view.

It is always explicit: an automatic one would add map views, which fetch tiles from the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import rerun.blueprint as rrb

from ltm_ros.viewer.scene_geometry import Eye

TIMELINE = "stamp"


@dataclass(frozen=True)
class MapWindow:
    """The part of the fuel grid that its view shows first, in cells: column and row ranges."""

    columns: tuple[float, float]
    rows: tuple[float, float]


@dataclass(frozen=True)
class Tabs:
    """Optional tabs: with a depth network (`fusion`), with a label network that takes `prompts`, with an updated
    surface (`terrain`)."""

    fusion: bool = False
    prompts: bool = False
    terrain: bool = False


def site_blueprint(
    cameras: Sequence[str], eye: Eye, window: MapWindow, live: bool, tabs: Tabs | None = None
) -> rrb.Blueprint:
    """Return the tabs: the site (terrain, fuel grid, a camera's images), all cameras, and `tabs`."""
    tabs = tabs or Tabs()
    overview = rrb.Vertical(
        rrb.Horizontal(
            _terrain(cameras, eye),
            rrb.Vertical(_fuel_grid(window), rrb.Spatial2DView(origin="/legend", name="Legend"), row_shares=[7, 1]),
            column_shares=[5, 3],
        ),
        rrb.Tabs(*(_camera_row(camera) for camera in cameras), active_tab=0),
        row_shares=[5, 3],
        name="Site",
    )
    gallery = rrb.Vertical(*(_camera_row(camera) for camera in cameras), name="Cameras")
    extra: list[rrb.Container] = []
    if tabs.fusion:
        extra.append(rrb.Vertical(*(_depth_row(camera) for camera in cameras), name="Depth"))
    if tabs.prompts:
        extra.append(rrb.Grid(*(_heat(camera) for camera in cameras), name="Prompt"))
    if tabs.terrain:
        extra.append(rrb.Horizontal(_terrain(cameras, eye), _changes(window), name="Surface"))
    return rrb.Blueprint(
        rrb.Tabs(overview, gallery, *extra, active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following" if live else None),
        auto_layout=False,
        auto_views=False,
    )


def _terrain(cameras: Sequence[str], eye: Eye) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="/map",
        name="Terrain",
        # Labels are below their camera for the 2D view; here they would cover the photo in its frustum.
        contents=[
            "+ $origin/**",
            *(f"- $origin/cameras/{camera}/{part}" for camera in cameras for part in ("labels", "heat")),
        ],
        background=(226, 234, 242),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)
        ),
    )


def _fuel_grid(window: MapWindow) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(origin="/fuel_map", name="Fuel map, north up", visual_bounds=_bounds(window))


def _bounds(window: MapWindow) -> rrb.VisualBounds2D:
    return rrb.VisualBounds2D(x_range=window.columns, y_range=window.rows)


def _changes(window: MapWindow) -> rrb.Spatial2DView:
    """Return the view of changes over the relief and the fuel map's cameras, in its cells, so that nothing moves as it
    grows."""
    return rrb.Spatial2DView(
        origin="/terrain",
        contents=["+ $origin/**", "+ /fuel_map/relief", "+ /fuel_map/cameras/**"],
        name="Surface: red removed, green grown, violet lowered, yellow unchanged",
        visual_bounds=_bounds(window),
    )


def _camera_row(camera: str) -> rrb.Horizontal:
    """Return image, depth and labels side by side."""
    origin = f"/map/cameras/{camera}"
    views: list[rrb.View] = [
        rrb.Spatial2DView(origin=origin, contents="+ $origin/photo", name=f"{camera}: image"),
        rrb.Spatial2DView(origin=f"/depth/{camera}", name=f"{camera}: depth"),
        rrb.Spatial2DView(origin=origin, contents=["+ $origin/photo", "+ $origin/labels"], name=f"{camera}: labels"),
    ]
    return rrb.Horizontal(*views, name=camera)


def _heat(camera: str) -> rrb.Spatial2DView:
    """Return the view of where a camera's images show the operator's prompt."""
    origin = f"/map/cameras/{camera}"
    return rrb.Spatial2DView(origin=origin, contents=["+ $origin/photo", "+ $origin/heat"], name=f"{camera}: prompt")


def _depth_row(camera: str) -> rrb.Horizontal:
    """Return the traced, network and fused depth, and the difference of fused and traced depth."""
    parts = {"traced": "traced", "network": "network", "fused": "fused", "difference": "fused - traced"}
    views = [rrb.Spatial2DView(origin=f"/fusion/{camera}/{p}", name=f"{camera}: {name}") for p, name in parts.items()]
    return rrb.Horizontal(*views, name=camera)
