"""Define the layout (blueprint) of the Rerun view.

It is always explicit: an automatic one would add map views, which fetch tiles from the network."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from ltm_ros.viewer.scene_geometry import Eye

TIMELINE = "stamp"


def site_blueprint(
    cameras: Sequence[str], eye: Eye, window: rrb.VisualBounds2D, live: bool, fusion: bool, prompts: bool, terrain: bool
) -> rrb.Blueprint:
    """Return the tabs: the site (terrain, fuel grid, a camera's images) and all cameras; with a depth network
    (`fusion`), with a label network that takes `prompts`, and with an updated surface (`terrain`) one more each.

    `window`: part of the fuel grid that its view shows first, in cells."""
    grid = rrb.Spatial2DView(origin="/fuel_map", name="Fuel map, north up", visual_bounds=window)
    legend = rrb.Spatial2DView(origin="/legend", name="Legend")
    overview = rrb.Vertical(
        rrb.Horizontal(_terrain(cameras, eye), rrb.Vertical(grid, legend, row_shares=[7, 1]), column_shares=[5, 3]),
        rrb.Tabs(*(_camera_row(camera) for camera in cameras), active_tab=0),
        row_shares=[5, 3],
        name="Site",
    )
    tabs: list[rrb.Container] = [overview, rrb.Vertical(*(_camera_row(camera) for camera in cameras), name="Cameras")]
    if fusion:
        tabs.append(rrb.Vertical(*(_depth_row(camera) for camera in cameras), name="Depth"))
    if prompts:
        tabs.append(rrb.Grid(*(_over_photo(camera, "heat", "prompt") for camera in cameras), name="Prompt"))
    if terrain:
        # Over the relief and the fuel map's cameras, in its cells, so that nothing moves as it grows.
        changes = rrb.Spatial2DView(
            origin="/terrain",
            contents=["+ $origin/**", "+ /fuel_map/relief", "+ /fuel_map/cameras/**"],
            name="Surface: red removed, green grown, violet lowered, yellow unchanged",
            visual_bounds=window,
        )
        tabs.append(rrb.Horizontal(_terrain(cameras, eye), changes, name="Surface"))
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0),
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
            kind=rrb.Eye3DKind.Orbital, position=eye[0], look_target=eye[1], eye_up=(0.0, 0.0, 1.0)
        ),
    )


def _over_photo(camera: str, part: str, name: str) -> rrb.Spatial2DView:
    contents = ["+ $origin/photo", f"+ $origin/{part}"] if part else ["+ $origin/photo"]
    return rrb.Spatial2DView(origin=f"/map/cameras/{camera}", contents=contents, name=f"{camera}: {name}")


def _camera_row(camera: str) -> rrb.Horizontal:
    """Return image, depth and labels side by side."""
    depth = rrb.Spatial2DView(origin=f"/depth/{camera}", name=f"{camera}: depth")
    labels = _over_photo(camera, "labels", "labels")
    return rrb.Horizontal(_over_photo(camera, "", "image"), depth, labels, name=camera)


def _depth_row(camera: str) -> rrb.Horizontal:
    """Return the traced, network and fused depth, and the difference of fused and traced depth."""
    parts = {"traced": "traced", "network": "network", "fused": "fused", "difference": "fused - traced"}
    views = [rrb.Spatial2DView(origin=f"/fusion/{camera}/{p}", name=f"{camera}: {name}") for p, name in parts.items()]
    return rrb.Horizontal(*views, name=camera)
