"""Draws the figures of `ltm-lab eval --report`: those of the paper, from a scored bag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.evenly import evenly
from ltm_core.base.types import Float32Array, RgbImage, UInt8Array
from ltm_core.fuel.cell_counts import UNSEEN
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pictures import (
    MapCamera,
    RangeScale,
    depth_colors,
    fit,
    label_colors,
    label_legend,
    labelled_shade,
    overlay_labels,
    panel,
    range_legend,
    terrain_colors,
    terrain_map_picture,
)
from ltm_core.pictures.legend import PAPER, error_colors, error_legend
from ltm_core.pictures.maps import fuel_map_picture
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.depth.depth_maps_io import DepthMapFolder
from ltm_lab.evaluation.pictures.block import BlockView, Pin, block_picture
from ltm_lab.evaluation.pictures.height_legend import height_legend
from ltm_lab.evaluation.run_score import estimates, in_metres, kind_of
from ltm_ros.recordings.frame_stream import FrameStream, StreamedFrame
from ltm_ros.recordings.recorded_run import Recorded, image_shape, recorded_votes

MAP_SIDE = 1500.0
"""Metres of the square that fuel maps show, as in the paper."""
HEADING_STEP_DEG = 20.0
_PANEL, _WIDE = 640, 860
"""Pixels of one picture in a sheet of four columns, and of fewer."""


@dataclass(frozen=True, eq=False)
class ScoredView:
    """One heading of one camera: what went in, what came out, what is true."""

    camera_name: str
    camera: Camera
    pose: Pose
    photo: RgbImage
    labels: UInt8Array | None
    truth_depth: Float32Array | None
    truth_labels: UInt8Array | None
    depths: dict[str, Float32Array]
    """Name of each source -> metres at the truth's pixels, or as it is where there is no truth."""

    @property
    def name(self) -> str:
        return f"{self.camera_name}, {self.pose.angles_deg[0]:.0f}°"


def views(stream: FrameStream, site: Site, folders: Sequence[DepthMapFolder] = (), most: int = 2) -> list[ScoredView]:
    """The first frame of each heading of each camera, at most `most` a camera, in the site's order of cameras."""
    found: list[ScoredView] = []
    headings: dict[str, list[float]] = {}
    for frame in stream.frames(["camera", "pose", "photo"]):
        pose: Pose = frame.take("pose")
        seen = headings.setdefault(frame.camera_name, [])
        azimuth = pose.angles_deg[0]
        if len(seen) < most and all(abs((azimuth - a + 180) % 360 - 180) >= HEADING_STEP_DEG for a in seen):
            seen.append(azimuth)
            found.append(_view(frame, site, folders))
    order = list(site.cameras)
    return sorted(found, key=lambda view: order.index(view.camera_name))


def _view(frame: StreamedFrame, site: Site, folders: Sequence[DepthMapFolder]) -> ScoredView:
    truth = frame.take("truth_depth")
    image = image_shape(frame, site)
    depths = {
        name: depth if truth is None else in_metres(depth, kind_of(name, folders), truth, image)
        for name, depth in estimates(frame, folders, image)
    }
    return ScoredView(
        frame.camera_name,
        frame.take("camera"),
        frame.take("pose"),
        frame.take("photo"),
        frame.take("labels"),
        truth,
        frame.take("truth_labels"),
        depths,
    )


def terrain_2d(dem: Dem, cameras: Sequence[MapCamera]) -> RgbImage:
    """The raster as the system holds it: tinted relief with the cameras and the heights of the tints."""
    picture = terrain_map_picture(dem, cameras=cameras, bounds=dem.geometry.bounds, width=1200)
    return np.concatenate([picture, height_legend(dem, picture.shape[1])])


def terrain_3d(dem: Dem, pins: Sequence[Pin], draped: RgbImage | None = None) -> RgbImage:
    """The same raster as a block, with its own tints or `draped` colours."""
    return block_picture(_at_most(dem, 1000), terrain_colors(_at_most(dem, 1000)) if draped is None else draped,
                         BlockView(), pins)  # fmt: skip


def fuel_3d(dem: Dem, classes: UInt8Array, geometry: GridGeometry, labels: LabelSet, pins: Sequence[Pin]) -> RgbImage:
    """The fuel map lying on the block."""
    coarse = _at_most(dem, 1000)
    colors = labelled_shade(classes, geometry, labels, coarse, coarse.geometry)
    picture = block_picture(coarse, colors, BlockView(), pins)
    shown = set(np.unique(classes[classes != UNSEEN]).tolist())
    return np.concatenate([picture, _legend(picture.shape[1], labels, shown)])


def _at_most(dem: Dem, cells: int) -> Dem:
    """Area means of the DEM where it has more cells a side: a picture shows no more."""
    step = -(-max(dem.elevation.shape) // cells)
    if step == 1:
        return dem
    grid = dem.geometry
    rows, cols = grid.height // step, grid.width // step
    heights = cv2.resize(dem.elevation[: rows * step, : cols * step], (cols, rows), interpolation=cv2.INTER_AREA)
    return Dem(
        np.asarray(heights, np.float32), GridGeometry(grid.x_min, grid.y_max, grid.resolution * step, cols, rows)
    )


def segmentation_pairs(
    simulated: Sequence[ScoredView],
    photos: Sequence[tuple[str, RgbImage]],
    segmenter: Segmenter | None,
    labels: LabelSet,
) -> RgbImage:
    """Rows of picture and labels: real photos first, then simulated frames with the network's labels and the true."""
    cells: list[tuple[str, RgbImage]] = []
    shown: set[int] = set()

    def add(name: str, photo: RgbImage, ids: UInt8Array) -> None:
        shown.update(np.unique(ids[ids != UNSEEN]).tolist())
        cells.append((name, overlay_labels(photo, ids, labels, opacity=0.62)))

    shape = simulated[0].photo.shape[:2] if simulated else None
    for name, photo in photos:
        if segmenter is not None:
            middle = _middle(photo, shape)
            cells.append((f"real: {name}", photo[middle]))
            add("real, labels of the network", photo[middle], segmenter.segment(photo).labels[middle])
    for view in simulated:
        if view.labels is not None:
            cells.append((f"simulated: {view.name}", view.photo))
            add("simulated, labels of the network", view.photo, view.labels)
    sheet = panel(cells, columns=4 if len(cells) > 2 else 2, width=_PANEL)
    return np.concatenate([sheet, _legend(sheet.shape[1], labels, shown)])


def _middle(photo: RgbImage, shape: tuple[int, int] | None) -> tuple[slice, slice]:
    """The middle of a photo in the proportions of `shape`, so that rows of a sheet are of one height."""
    height, width = photo.shape[:2]
    if shape is None:
        return slice(0, height), slice(0, width)
    rows, cols = min(height, width * shape[0] // shape[1]), min(width, height * shape[1] // shape[0])
    top, left = (height - rows) // 2, (width - cols) // 2
    return slice(top, top + rows), slice(left, left + cols)


def truth_and_labels(simulated: Sequence[ScoredView], labels: LabelSet) -> RgbImage | None:
    """Photo, true classes and the network's labels of each view; None without truth."""
    cells: list[tuple[str, RgbImage]] = []
    shown: set[int] = set()
    for view in simulated:
        if view.labels is None or view.truth_labels is None:
            continue
        cells.append((view.name, view.photo))
        beyond = ", dark: beyond the map" if np.any(view.truth_labels == UNSEEN) else ""
        for name, ids in ((f"true classes{beyond}", view.truth_labels), ("labels of the network", view.labels)):
            shown.update(np.unique(ids[ids != UNSEEN]).tolist())
            cells.append((name, label_colors(ids, labels)))
    if not cells:
        return None
    sheet = panel(cells, columns=3, width=_WIDE)
    return np.concatenate([sheet, _legend(sheet.shape[1], labels, shown)])


def depth_panels(view: ScoredView) -> RgbImage:
    """Photo and truth, then a row for every source of depth: in the truth's colours, and how far it is off."""
    arrays = list(view.depths.values()) + ([view.truth_depth] if view.truth_depth is not None else [])
    scale = RangeScale.of(np.concatenate([array[::4, ::4].ravel() for array in arrays]))
    cells: list[tuple[str, RgbImage]] = [(view.name, view.photo)]
    truth = view.truth_depth
    if truth is not None:
        cells.append(("true depth of the visible surface", depth_colors(truth, scale)))
    for name, depth in view.depths.items():
        none = ", dark: none" if np.isnan(depth).any() else ""
        cells.append((f"{name} depth{none}", depth_colors(depth, scale)))
        if truth is not None:
            both = np.isfinite(depth) & np.isfinite(truth)
            middle = np.median(np.abs(depth[both] - truth[both])) if both.any() else np.nan
            cells.append((f"error of {name} depth, median {middle:.1f} m", error_colors(depth, truth)))
    sheet = panel(cells, 2, _WIDE)
    half = sheet.shape[1] // 2
    legends = [range_legend(half, scale), error_legend(sheet.shape[1] - half)]
    height = max(legend.shape[0] for legend in legends)
    return np.concatenate([sheet, np.hstack([_lower(legend, height) for legend in legends])])


def fuel_maps(
    rows: Sequence[tuple[str, dict[str, UInt8Array]]],
    around: dict[str, UInt8Array],
    geometry: GridGeometry,
    dem: Dem,
    cameras: Sequence[MapCamera],
    labels: LabelSet,
) -> RgbImage:
    """Fuel maps of 1,500 x 1,500 m, a row a camera (two) and a column a state: (name, class ids by camera).

    `around`: what is seen, by camera: the square lies around it.
    """
    names = list(dict.fromkeys(camera.name for camera in cameras if camera.name))[:2]
    bounds = _square(list(around.values()), geometry, cameras, dem)
    cells: list[tuple[str, RgbImage]] = []
    for name in names:
        places = {camera.position for camera in cameras if camera.name == name}
        own = [camera for camera in cameras if camera.position in places]
        for state, maps in rows:
            classes = maps.get(name, np.full(geometry.shape, UNSEEN, np.uint8))
            cells.append((f"{name}: {state}", fuel_map_picture(classes, geometry, labels, dem, own, bounds, _PANEL)))
    return panel(cells, columns=len(rows), width=_PANEL)


def _square(
    maps: Sequence[UInt8Array], geometry: GridGeometry, cameras: Sequence[MapCamera], dem: Dem
) -> tuple[float, float, float, float]:
    """1,500 m a side around what is seen, moved to hold the cameras where it can, and to lie on the terrain."""
    seen = np.any([classes != UNSEEN for classes in maps], axis=0)
    x_min, y_min, x_max, y_max = dem.geometry.bounds
    side = min(MAP_SIDE, x_max - x_min, y_max - y_min)
    rows, cols = np.nonzero(seen)
    centre = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2])
    if rows.size:
        x, y = geometry.to_map(rows, cols)
        centre = np.array([np.median(x), np.median(y)])
    stands = np.array([camera.position for camera in cameras])
    if stands.size and np.ptp(stands, axis=0).max() < side:
        margin = 0.05 * side
        low, high = stands.max(axis=0) + margin - side / 2, stands.min(axis=0) - margin + side / 2
        centre = np.where(low <= high, np.clip(centre, low, high), centre)
    half = side / 2
    centre = np.clip(centre, [x_min + half, y_min + half], [x_max - half, y_max - half])
    (x0, y0), (x1, y1) = centre - half, centre + half
    return float(x0), float(y0), float(x1), float(y1)


def map_cameras(seen: Sequence[ScoredView], reach: float = 900.0) -> list[MapCamera]:
    """Where the cameras stand and look: every heading of every camera, named once."""
    named: set[str] = set()
    found = []
    for view in seen:
        name = "" if view.camera_name in named else view.camera_name
        named.add(view.camera_name)
        place = (float(view.pose.position[0]), float(view.pose.position[1]))
        found.append(MapCamera(name, view.camera, place, view.pose.angles_deg[0], reach))
    return found


def pins(seen: Sequence[ScoredView]) -> list[Pin]:
    """Each camera once."""
    places = {view.camera_name: tuple(float(v) for v in view.pose.position) for view in seen}
    return [Pin(name, place) for name, place in places.items()]  # type: ignore[arg-type]


def camera_maps(recorded: Recorded, geometry: GridGeometry, labels: LabelSet) -> dict[str, UInt8Array]:
    """The majority map of each camera's own votes in a bag, on the site's fuel grid (map frame)."""
    from ltm_core.fuel.cell_counts import MajorityFuelMap

    maps: dict[str, MajorityFuelMap] = {}
    for votes in recorded_votes(recorded, geometry, labels):
        maps.setdefault(votes.source, MajorityFuelMap(geometry, len(labels))).add(votes)
    return {name: map_.classes() for name, map_ in maps.items()}


def real_photos(folder: Path, most: int) -> list[tuple[str, RgbImage]]:
    """Pictures of a folder, evenly spread over their names, at most 1,280 pixels wide."""
    from ltm_lab.evaluation.sim2real.picture_folder_io import pictures_below

    chosen = evenly(pictures_below(folder), most)
    loaded = [(path.stem, cv2.imread(str(path), cv2.IMREAD_COLOR)) for path in chosen]
    return [(name, fit(np.ascontiguousarray(bgr[..., ::-1]), 1280)) for name, bgr in loaded if bgr is not None]


def _legend(width: int, labels: LabelSet, shown: set[int]) -> RgbImage:
    """The classes shown, in letters that do not grow with a wide sheet."""
    narrow = label_legend(min(width, 1000), labels, shown)
    return _padded(narrow, narrow.shape[0], width)


def _lower(legend: RgbImage, height: int) -> RgbImage:
    return _padded(legend, height, legend.shape[1])


def _padded(picture: RgbImage, height: int, width: int) -> RgbImage:
    sheet = np.full((height, width, 3), PAPER, np.uint8)
    sheet[: picture.shape[0], : picture.shape[1]] = picture
    return sheet
