"""`ltm pose import`: convert other tools' poses into pose files, and check their axes and units with photos."""

import re
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ltm_core.base.errors import ConfigError, PoseError
from ltm_core.base.types import UInt8Array
from ltm_core.cameras.foreign_camera import ForeignPose, alternatives
from ltm_core.cameras.plausibility import doubt_of_height
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.pictures import to_png
from ltm_core.pictures.trace import pose_fit_picture
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.storage.disk_io import require_files
from ltm_core.storage.image_io import read_rgb
from ltm_core.tracing.trace_io import write_pose_file
from ltm_core.vision.segmenter import Segmenter
from ltm_ros.cli.output import OptionalDems, Overwrite, command_group, open_dems, print_table, say, warn
from ltm_ros.cli.pose_mount import mount
from ltm_ros.cli.pose_photo import photo
from ltm_ros.cli.pose_points import points
from ltm_ros.recordings.importing.foreign_poses import read_foreign_poses, read_transform
from ltm_ros.recordings.importing.pose_check import Placement, chosen_reading, readings

_MOST_TESTED = 3
"""Maximum number of photos by which axes and units are tested."""
_RAYS = True, 0.13  # curvature and refraction
_LEAST_FIT = 0.35
"""Minimum share of the photos' skylines on the terrain's below which a warning is printed."""


def import_poses(
    file: Annotated[Path, Argument(metavar="FILE", help="File or folder of the other tool.")],
    out: Annotated[Path, Option("--out", "-o", help="Folder of pose files to write.")],
    dem: OptionalDems = None,
    photos: Annotated[Path | None, Option(help="Folder of the photos; with --dem, tests axes and units.")] = None,
    crs: Annotated[str | None, Option(help="CRS of the poses, if neither file nor DEM states it.")] = None,
    focal: Annotated[
        str | None, Option(metavar="LENGTH", help="1484px, 24/36 (mm/sensor width), or share of the longer side.")
    ] = None,
    size: Annotated[str | None, Option(metavar="WxH", help="Image size. Default: that of the photos.")] = None,
    transform: Annotated[Path | None, Option(metavar="FILE", help="Similarity from COLMAP's model to the map.")] = None,
    geoid_undulation_m: Annotated[float, Option(help="Geoid above ellipsoid in metres, for GPS heights.")] = 0.0,
    picture: Annotated[Path | None, Option(help="Folder for PNGs of terrain lines over the photos.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Convert poses of Metashape, COLMAP, OpenSfM, alproj, ImGRAFT, PRACTISE, Pic2Map, or omega, phi, kappa.

    With --dem and --photos, other axes, angle units and image sides are tested, and used if they fit clearly better."""
    sides = _size(size, photos)
    camera = _camera(focal, sides) if focal is not None and sides is not None else None
    tool, poses = read_foreign_poses(file, sides, camera, read_transform(transform) if transform else None)
    names = [_file_name(pose.name) for pose in poses]
    if len(set(names)) < len(names):
        raise PoseError(f"{file}: several photos have the same name without suffix; rename them")
    require_files((out / name for name in names), overwrite)
    terrain = open_dems(dem, crs) if dem else None
    placed_in = crs or (terrain.geometry.crs if terrain is not None else None)
    if placed_in is None:
        raise ConfigError(f"{file}: the poses have no projected CRS; give --crs EPSG:... or --dem")
    x, y = poses[0].pose(SiteFrame(placed_in), lambda x, y: 0.0, 0.0).position[:2]
    frame = SiteFrame(placed_in, round(x / 1000) * 1000.0, round(y / 1000) * 1000.0)
    local = terrain.in_frame(frame) if terrain is not None else None
    placement = Placement(frame, local, ray_bend(*_RAYS), geoid_undulation_m)
    seen = _photos(poses, photos) if photos is not None and local is not None else {}
    found = readings(poses, placement, seen)
    print_table(
        f"{tool}: {len(poses)} poses, tested with {len(seen)} photos",
        ("reading", ">skyline that fits", ">cost", "problem"),
        [(r.how, _shown(r.fits, ".0%"), _shown(r.cost, ".1f"), r.problem or "") for r in found],
    )
    how = chosen_reading(found)
    if how is not found[0]:
        warn(f"{file} fits the photos {how.how}; this is used.")
    elif how.fits is not None and how.fits < _LEAST_FIT:
        warn("No axes and units fit the photos. Check position, focal length, distortion and the DEM.")
    elif how.fits is None:
        warn("Axes and units were not tested. To test them, give --dem and --photos.")
    rejected, doubts = 0, []
    out.mkdir(parents=True, exist_ok=True)
    for stated, name in zip(poses, names, strict=True):
        chosen = alternatives(stated)[how.how]
        placed = placement.placed(chosen)
        if placed.problem is not None:
            rejected += 1
            warn(f"{stated.name}: rejected: {placed.problem}")
            continue
        x, y, z = placed.pose.position
        if local is not None and (doubt := doubt_of_height(z, float(local.elevation_at(x, y)))) is not None:
            doubts.append(f"{stated.name}: {doubt}")
        note = f"From {file.name} ({tool}), {how.how}."
        write_pose_file(out / name, placed.camera, placed.pose, {}, _RAYS, frame, [note])
        if picture is not None and stated.name in seen:
            _draw(picture / Path(name).with_suffix(".png"), seen[stated.name][0], chosen, placement, how.how)
    if doubts:
        warn(doubts[0] + (f" (and {len(doubts) - 1} more photos)" if len(doubts) > 1 else ""))
    say(f"  {out}: {len(poses) - rejected} pose files")
    if rejected == len(poses):
        raise PoseError(f"{file}: none of {len(poses)} poses is possible on this terrain; check --crs, axes and units")


def _shown(value: float | None, form: str) -> str:
    return "" if value is None else f"{value:{form}}"


def _file_name(name: str) -> str:
    return f"{Path(name.replace(chr(92), '/')).name.rpartition('.')[0] or Path(name).name}.yaml"


def _size(size: str | None, photos: Path | None) -> tuple[int, int] | None:
    """Return width and height as stated, or of the first photo; None if there is neither."""
    if size is not None:
        sides = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", size)
        if sides is None:
            raise ConfigError(f"--size {size}: give width and height in pixels, such as 4000x3000")
        return int(sides[1]), int(sides[2])
    files = sorted(photos.iterdir()) if photos is not None else []
    image = next((path for path in files if path.suffix.lower() in (".jpg", ".jpeg", ".png")), None)
    if image is None:
        return None
    height, width = read_rgb(image).shape[:2]
    return width, height


def _camera(focal: str, size: tuple[int, int]) -> Camera:
    """Return the camera of --focal."""
    number = r"\d+\.?\d*|\.\d+"
    form = re.fullmatch(rf"({number})(px|/({number}))?", focal)
    if form is None or not float(form[1]) > 0 or (form[3] and not float(form[3]) > 0):
        raise ConfigError(f"--focal {focal}: give 1484px, 24/36 (mm/sensor width) or 0.9 (of the longer side)")
    length, (width, height) = float(form[1]), size
    fx = length if form[2] == "px" else length * width / float(form[3]) if form[3] else length * max(width, height)
    return Camera(width, height, fx, fx, (width - 1) / 2, (height - 1) / 2)


def _photos(poses: list[ForeignPose], folder: Path) -> dict[str, tuple[UInt8Array, UInt8Array]]:
    """Return some of the photos with their labels, by the names of their poses."""
    by_stem = {path.stem: path for path in sorted(folder.iterdir())}
    named = [(pose.name, by_stem.get(Path(_file_name(pose.name)).stem)) for pose in poses]
    known = [(name, path) for name, path in named if path is not None]
    if not known:
        return {}
    segmenter = Segmenter.open()
    some = known[:: max(1, len(known) // _MOST_TESTED)][:_MOST_TESTED]
    found = {}
    for name, path in some:
        photo = read_rgb(path)
        found[name] = (photo, segmenter.segment(photo).labels)
    return found


def _draw(path: Path, photo: UInt8Array, foreign: ForeignPose, placement: Placement, how: str) -> None:
    placed = placement.placed(foreign)
    if placement.dem is None or photo.shape[:2] != (placed.camera.height, placed.camera.width):
        return
    terrain = SearchTerrain(placement.dem, placement.bend)
    horizon = terrain.horizon_for(placed.camera, PosePrior(placed.pose, 1.0))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet = [(f"{foreign.name}, {how}", placed.camera, placed.pose)]
    path.write_bytes(to_png(pose_fit_picture(photo, placed.camera, horizon, sheet)))


pose = command_group("Find or import camera poses; calibrate a PTZ mount.")
for _method in (points, photo, mount):
    pose.command()(_method)
pose.command("import")(import_poses)
