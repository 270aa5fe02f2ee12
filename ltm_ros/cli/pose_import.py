"""`ltm pose import`: convert other tools' poses into pose files, and draw the terrain's lines over the photos."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.base.errors import ConfigError, PoseError
from ltm_core.storage.disk_io import require_files
from ltm_ros.cli.output import Overwrite, open_dems

if TYPE_CHECKING:
    from ltm_core.geometry.camera import Camera
    from ltm_core.geometry.geodesy import SiteFrame
    from ltm_core.geometry.pose import Pose
    from ltm_core.raster.dem import Dem


def import_poses(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File or folder of the other tool.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of pose files to write.")],
    dem: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="Elevation raster; repeat for coarser surrounding ones.")
    ] = None,
    photos: Annotated[Path | None, typer.Option(help="Folder of the photos, for --picture.")] = None,
    crs: Annotated[str | None, typer.Option(help="CRS of the poses, if neither file nor DEM states it.")] = None,
    focal: Annotated[float | None, typer.Option(help="Focal length in pixels, if the file states no lens.")] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Image size, with --focal.")] = None,
    transform: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Similarity from COLMAP's model to the map.")
    ] = None,
    geoid_undulation_m: Annotated[float, typer.Option(help="Geoid above ellipsoid in metres, for GPS heights.")] = 0.0,
    picture: Annotated[Path | None, typer.Option(help="Folder for PNGs of terrain lines over the photos.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Convert poses of Metashape, COLMAP, OpenSfM, or omega, phi, kappa. Check them with --dem, --photos, --picture."""
    from rich.console import Console
    from rich.markup import escape

    from ltm_core.geometry.geodesy import SiteFrame
    from ltm_ros.recordings.importing.foreign_poses import problem_of, read_foreign_poses, read_transform

    if picture is not None and (photos is None or not dem):
        raise ConfigError("--picture draws terrain over photos: give --dem and --photos")
    console = Console()
    tool, poses = read_foreign_poses(file, _camera(focal, size), read_transform(transform) if transform else None)
    names = [_file_name(pose.name) for pose in poses]
    if len(set(names)) < len(names):
        raise PoseError(f"{file}: several photos have the same name without suffix; rename them")
    require_files((out / name for name in names), overwrite)
    terrain = open_dems(dem, crs) if dem else None
    placed_in = crs or (terrain.geometry.crs if terrain is not None else None)
    if placed_in is None:
        raise ConfigError(f"{file}: the poses have no projected CRS; give --crs EPSG:... or --dem")
    x, y = poses[0].pose(SiteFrame(placed_in)).position[:2]
    frame = SiteFrame(placed_in, round(x / 1000) * 1000.0, round(y / 1000) * 1000.0)
    local = terrain.in_frame(frame) if terrain is not None else None
    by_stem = {path.stem: path for path in sorted(photos.iterdir())} if photos is not None else {}
    written = 0
    for foreign, name in zip(poses, names, strict=True):
        if foreign.camera is None:
            raise PoseError(f"{foreign.place}: no focal length is known; give --focal and --size")
        pose = foreign.pose(frame, geoid_undulation_m)
        if problem := problem_of(pose, local):
            console.print(f"[yellow]{escape(foreign.name)}: rejected: {escape(problem)}", highlight=False)
            continue
        _write(out / name, pose, foreign.camera, frame, f"From {file.name} ({tool}).")
        written += 1
        stem = Path(name).stem
        if picture is not None and local is not None and stem in by_stem:
            _draw(picture / f"{stem}.png", by_stem[stem], foreign.camera, pose, local)
    console.print(f"  {out}: {written} of {len(poses)} poses of {tool}", highlight=False)
    if not written:
        raise PoseError(f"{file}: no pose is possible on this terrain; check axes, units, heights and CRS")


def _file_name(name: str) -> str:
    return f"{Path(name.replace(chr(92), '/')).name.rpartition('.')[0] or Path(name).name}.yaml"


def _camera(focal: float | None, size: str | None) -> Camera | None:
    """Return the camera of --focal and --size; None without them."""
    from ltm_core.geometry.camera import Camera

    if focal is None and size is None:
        return None
    sides = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", size or "")
    if sides is None or focal is None or not focal > 0:
        raise ConfigError(f"--focal {focal} --size {size}: give both in pixels, such as --focal 1484 --size 4000x3000")
    width, height = int(sides[1]), int(sides[2])
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def _write(path: Path, pose: Pose, camera: Camera, frame: SiteFrame, note: str) -> None:
    from ltm_core.tracing.trace_io import GuessConfig, write_pose_file

    path.parent.mkdir(parents=True, exist_ok=True)
    calibration = {"width": camera.width, "height": camera.height, "fx": camera.fx}
    guess = GuessConfig.model_validate({"pose": {"x": 0.0, "y": 0.0, "z": 0.0}, "calibration": calibration})
    write_pose_file(path, camera, pose, {}, guess, frame, [note])


def _draw(path: Path, photo: Path, camera: Camera, pose: Pose, dem: Dem) -> None:
    from ltm_core.geometry.geodesy import ray_bend
    from ltm_core.pictures import to_png
    from ltm_core.pictures.trace import pose_fit_picture
    from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
    from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
    from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
    from ltm_core.tracing.trace_io import read_photo

    terrain = SearchTerrain(dem, ray_bend(True, 0.13))
    horizon = terrain.horizon_for(camera, PosePrior(pose, 1.0), PicturePoseConfig())
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = pose_fit_picture(read_photo(photo, camera), camera, horizon, [(path.stem, camera, pose)])
    path.write_bytes(to_png(drawn))
