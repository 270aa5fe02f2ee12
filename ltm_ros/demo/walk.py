"""Run the walk of `make demo`: photos taken with a phone, whose poses are found in the photos."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.resources import config_path
from ltm_core.base.types import Float64Array, RgbImage
from ltm_core.fuel.class_map import MajorityFuelMap, read_fuel_map
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import label_legend, with_legend
from ltm_core.pictures.maps import furnished, relief, scale_bar, view_of
from ltm_core.raster.dem import Dem
from ltm_core.scoring.fuel import score_fuel
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_ros.demo.report import Sheet
from ltm_ros.demo.score import RecordedPoseErrors, recorded_pose_errors, recorded_poses
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.build import import_photos
from ltm_ros.recordings.importing.refinement import PoseRefinement
from ltm_ros.recordings.recorded_run import FUEL_TRUTH, Recorded, recorded_votes
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline

PHONE = Assumptions(focal_35mm=26.0, height_above_ground=1.6)
"""Lens of the phone and height above ground, which the recording lacks."""
_WIDTH = 1000
_COLORS = ((205, 40, 40), (0, 130, 220), (25, 25, 25), (240, 150, 0))
_SHARE = 0.11
"""Length of an arrow as a share of the map's width."""
_SHIFT = 4  # OpenCV draws at 1/16 pixel


@dataclass(frozen=True, eq=False)
class WalkMap:
    """Result of the walk with poses of one kind.

    `errors`: of these poses. `cells`: cells with labels. `known`: of those, with truth; `right`: with the correct most
    frequent label.
    """

    poses: str
    errors: RecordedPoseErrors
    cells: int
    right: int
    known: int

    @property
    def right_percent(self) -> float:
        return 100 * self.right / max(1, self.known)


@dataclass(frozen=True, eq=False)
class Walk:
    """`maps`: for the phone's poses, those found in the photos, and the true ones. `accepted`: poses that
    were found.
    """

    photos: int
    accepted: int
    maps: tuple[WalkMap, ...]
    picture: RgbImage


def run_walk(walk: Path, out: Path, progress: Callable[[int, int], None]) -> Walk:
    """Import the walk (site.yaml, sensor_logger.zip, photos/, true_poses.csv) into `out` and replay it offline,
    with the phone's poses, the pictures', and the true ones. Raises LtmError.
    """
    site_path = walk / "site.yaml"
    site = load_site(site_path)
    log = [walk / "sensor_logger.zip"]
    found = import_photos(
        log, out / "found", site=site, assumed=PHONE, progress=progress, refinement=PoseRefinement(site)
    )
    import_photos(log, out / "phone", site=site, assumed=PHONE)
    import_photos([walk / "photos"], out / "true", walk / "true_poses.csv", site)
    kinds = (("phone", "of the phone's sensors"), ("found", "found in the photos"), ("true", "true"))
    maps, directions = [], {}
    for name, title in kinds:
        options = ReplayOptions(record=out / f"{name}_map")
        run_offline(out / name, site_path, options, lambda done, total: None)
        errors = recorded_pose_errors(out / name, out / "true", site)
        maps.append(_map(title, errors, Recorded(out / f"{name}_map", site_path, site, walk.parent / "demo")))
        directions[title] = _directions(out / name, site)
    accepted = sum(refinement.verdict == "accepted" for _, refinement in found.refined)
    return Walk(len(found.refined), accepted, tuple(maps), walk_map(site.open_dem(), directions))


def walk_sheet(walk: Walk) -> Sheet:
    """Return the walk's section of the report."""
    phone, found, _ = walk.maps
    (told, _), (refined, _) = phone.errors.azimuth_deg, found.errors.azimuth_deg
    share = [row.right_percent for row in walk.maps]
    return Sheet(
        "A walk with a phone",
        walk.picture,
        f"{walk.photos} simulated photos. The median compass error of the phone is {told:.1f}°. {walk.accepted} "
        f"poses were found in the photos; their compass errors correct the others, to a median of {refined:.1f}°. "
        f"Correct labels: {share[0]:.0f} % of the cells with the phone's poses, {share[1]:.0f} % with the found "
        f"poses, {share[2]:.0f} % with the true poses.",
    )


def _directions(bag: Path, site: Site) -> Float64Array:
    """Return (N, 3): x, y in the map frame and azimuth in degrees."""
    poses = [pose for pose, _ in recorded_poses(bag, site).values()]
    return np.array([[*pose.position[:2], pose.angles_deg[0]] for pose in poses])


def _map(title: str, errors: RecordedPoseErrors, recorded: Recorded) -> WalkMap:
    labels = LabelSet.load(config_path(recorded.site.labels))
    grid = recorded.site.fuel_geometry(recorded.site.open_dem())
    votes = MajorityFuelMap(grid, len(labels))
    for frame in recorded_votes(recorded, grid, labels):
        votes.add(frame)
    classes = votes.classes()
    truth = read_fuel_map(recorded.truth / FUEL_TRUTH)
    score = score_fuel(classes, recorded.site.in_crs(grid), *truth, len(labels))
    return WalkMap(title, errors, int((classes != 255).sum()), score.right, score.seen)


@dataclass(frozen=True)
class _Kinds:
    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]


def walk_map(dem: Dem, directions: Mapping[str, Float64Array]) -> RgbImage:
    """Draw arrows over relief, (H, W, 3).

    `directions`: by the name of their kind, (N, 3): x, y in the map frame (m) and azimuth (degrees), at most four
    kinds; later ones are drawn over earlier ones.
    """
    view = _view(np.concatenate(list(directions.values())))
    picture = relief(dem, view)
    reach = _SHARE * view.width * view.resolution
    for (_, poses), color in zip(directions.items(), _COLORS, strict=False):
        azimuth = np.radians(poses[:, 2])
        tips = poses[:, :2] + reach * np.column_stack([np.sin(azimuth), np.cos(azimuth)])
        for begin, end in zip(_pixels(view, poses[:, :2]), _pixels(view, tips), strict=True):
            cv2.arrowedLine(picture, begin, end, color, 2, cv2.LINE_AA, _SHIFT, 0.12)
    kinds = _Kinds(tuple(directions), _COLORS[: len(directions)])
    furniture = furnished(picture, view, [], None)
    return with_legend(furniture, scale_bar(view), label_legend(_WIDTH, kinds, range(len(kinds.names))))


def _view(poses: Float64Array) -> GridGeometry:
    low, high = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
    span = float((high - low).max())
    margin = max(30.0, 0.25 * span)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 0.3 * span) + margin
    return view_of((*(middle - half), *(middle + half)), _WIDTH)


def _pixels(view: GridGeometry, points: Float64Array) -> list[tuple[int, int]]:
    row, col = view.to_grid(points[:, 0], points[:, 1])
    return [(round(c * 2**_SHIFT), round(r * 2**_SHIFT)) for c, r in zip(col.tolist(), row.tolist(), strict=True)]
