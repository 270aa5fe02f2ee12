"""`ltm pose photo`: find the poses of photos from their skylines and ridges."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ltm_core.base.errors import ConfigError, ImageError
from ltm_core.storage.disk_io import require_files, require_folder
from ltm_ros.cli.output import Overwrite, open_dems, print_table
from ltm_ros.cli.pose_points import lens_kind, parameter_names

if TYPE_CHECKING:
    from ltm_core.base.types import UInt8Array
    from ltm_core.geometry.camera import Camera
    from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence
    from ltm_core.pose_estimation.skyline.find_pose import PictureSearch
    from ltm_core.pose_estimation.skyline.picture_pose_io import PoseResult, SearchSetup
    from ltm_core.raster.dem import Dem
    from ltm_core.tracing.trace_io import GuessConfig
    from ltm_core.vision.scene_view import SceneFilter
    from ltm_core.vision.segmenter import Segmenter

NOT_ACCEPTED = 3
"""Exit code of a search whose result is not accepted."""
FOCAL_SIGMA = 0.05
"""Relative standard deviation of a focal length to fit; the search covers twice this."""

FREE_POSITION_SIGMA = 10.0
"""Standard deviation in metres of a position to fit that states none."""


@dataclass(frozen=True)
class PhotoOptions:
    """Options of one search: source of labels, what is fitted besides the angles, type of DEM."""

    labels: Path | None
    model: str
    free: tuple[str, ...]
    canopy: bool
    mount: bool
    lens: str | None = None
    """Kind of lens whose focal length and k1 are fitted; None: they are as stated."""
    mask: Path | None = None
    """Mask PNG: non-zero pixels are ignored in all photos."""


@dataclass(frozen=True, eq=False)
class FoundPhoto:
    """A photo with its search and result."""

    name: str
    guess: GuessConfig
    setup: SearchSetup
    photo: UInt8Array
    search: PictureSearch
    result: PoseResult
    word: str
    reason: str
    seconds: float

    @property
    def usable(self) -> bool:
        """Return whether there is a pose to write: the accepted one, or the given one, unless that lacks a direction or
        the photo fits several."""
        return self.result.accepted or (self.word != "ambiguous" and self.guess.pose.azimuth_deg is not None)


def photo(
    photo: Annotated[Path, typer.Argument(metavar="PHOTO", help="Photo, or with a photo list a folder of photos.")],
    guess: Annotated[Path, typer.Option(metavar="FILE", help="Pose file, or photo list (CSV), with what is known.")],
    dem: Annotated[
        list[Path], typer.Option(metavar="FILE", help="Elevation raster; repeat for coarser surrounding ones.")
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="Pose file to write; with a photo list, a folder.")
    ],
    mount: Annotated[
        bool, typer.Option("--mount", help="All photos are of one fixed camera or PTZ head: find one correction.")
    ] = False,
    free: Annotated[
        str, typer.Option(metavar="NAMES", help="Also fit focal, position, lens, lens:phone (ptz, action, slr).")
    ] = "none",
    labels: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PNG of class ids, replaces the segmentation network.")
    ] = None,
    mask: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Mask PNG (`ltm mask`); non-zero pixels are ignored.")
    ] = None,
    model: Annotated[str, typer.Option(metavar="NAME", help="Segmentation network. Default: the shipped one.")] = "",
    canopy: Annotated[
        bool, typer.Option("--canopy", help="The DEM includes tree tops (a surface model, not bare earth).")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PNG of terrain lines over the photo, before and after.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE", help="JSON with residuals, verdict and covariance.")
    ] = None,
    crs: Annotated[str | None, typer.Option(help="CRS of the DEM, if its file states none.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Find a camera's pose from the skyline and ridges in its photo.

    Exit code 3: a pose was not accepted. An ambiguous one, or one without a stated azimuth, is not written."""
    from rich.console import Console

    from ltm_core.storage.config_io import load_yaml
    from ltm_core.tracing.trace_io import GuessConfig

    many = photo.is_dir()
    if many:
        require_folder(out)
    require_files([place for place in (None if many else out, report, None if many else picture) if place], overwrite)
    chosen = parameter_names(free)
    lens = lens_kind(chosen)
    if set(chosen) - {"focal", "position"}:
        raise ConfigError(f"--free {free}: a skyline fits focal, position and lens")
    guesses = guesses_of(photo, guess) if many else {photo: load_yaml(guess, GuessConfig)}
    terrain = open_dems(dem, crs)
    found = search_photos(guesses, terrain, PhotoOptions(labels, model, tuple(chosen), canopy, mount, lens, mask))
    write_photos(found, out, picture, report, many)
    rows = []
    for f in found:
        angles, given = f.result.pose.angles_deg, f.setup.prior.pose.angles_deg
        moved = ((angles[0] - given[0] + 180) % 360 - 180, angles[1] - given[1], angles[2] - given[2])
        cells = ["-"] * 5
        if f.usable:
            sigma = ", ".join(f"{s:.2f}" for s in f.search.verdict.sigma_deg) if f.result.accepted else "as given"
            cells = [*(f"{a:.3f}" for a in angles), sigma, ", ".join(f"{m:+.2f}" for m in moved)]
        rows.append((f.name, f.word, *cells))
    console = Console()
    columns = ("photo", "verdict", ">azimuth", ">pitch", ">roll", "sigma, deg", "difference from the input")
    print_table(console, "poses", columns, rows)
    for f in found:
        if not f.result.accepted:
            kept = "the given pose is kept" if f.usable else "no pose was written"
            uncalibrated = not lens and not any(f.setup.camera.distortion)
            fix = "; if the lens is not calibrated, --free lens fits it" if uncalibrated else ""
            console.print(f"[yellow]{f.name}: {f.word}, {kept}: {f.reason}{fix}", highlight=False)
    if any(f.usable for f in found):
        console.print(f"  {out}", highlight=False)
    if not all(f.result.accepted for f in found):
        raise typer.Exit(NOT_ACCEPTED)


def guesses_of(photos: Path, poses: Path) -> dict[Path, GuessConfig]:
    """Return the photos of a folder that a photo list names, with their known values. Raises ConfigError."""
    from ltm_core.storage.config_io import checked
    from ltm_core.storage.image_io import read_rgb
    from ltm_core.tracing.trace_io import GuessConfig
    from ltm_ros.recordings.importing.photo import read_pose_file

    found = {}
    for name, row in read_pose_file(poses).items():
        file = photos / name
        if not file.is_file():
            raise ConfigError(f"{poses} names {name}, which is not in {photos}")
        lens = row.calibration.model_dump(exclude_none=True)
        if row.calibration.width is None:
            height, width = read_rgb(file).shape[:2]
            lens |= {"width": width, "height": height}
        known = {"pose": row.pose.model_dump(exclude_none=True), "calibration": lens}
        found[file] = checked(GuessConfig, known, f"{poses}: {name}")
    return found


def search_photos(guesses: dict[Path, GuessConfig], dem: Dem, options: PhotoOptions) -> list[FoundPhoto]:
    """Search the pose of each photo; with `mount`, find one correction for all of them."""
    from ltm_core.pose_estimation.skyline.picture_pose_config import CANOPY_SURFACE, PicturePoseConfig, SkylineConfig
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.masks import MaskMaker
    from ltm_core.vision.scene_view import SceneFilter
    from ltm_core.vision.segmenter import Segmenter

    config = PicturePoseConfig(skyline=SkylineConfig(cover=CANOPY_SURFACE)) if options.canopy else PicturePoseConfig()
    segmenter = None if options.labels is not None else Segmenter.open(options.model or DEFAULT_MODEL)
    scene = SceneFilter(None if options.mask is None else MaskMaker(options.mask, "--mask"))
    found = [_find(file, guess, dem, segmenter, scene, options, config) for file, guess in guesses.items()]
    if options.mount and options.lens is not None:
        shared = _common_lens([f.result.camera for f in found if f.result.accepted])
        options = replace(options, lens=None)
        found = [_find(*photo, dem, segmenter, scene, options, config, shared) for photo in guesses.items()]
    return _as_one_mount(found, config, options) if options.mount else found


def _common_lens(cameras: list[Camera]) -> Camera | None:
    """Return a camera with the median focal length and k1; None without cameras. Raises ConfigError if the photos were
    not taken by one lens at one zoom."""
    import numpy as np

    from ltm_core.base.errors import ConfigError

    if not cameras:
        return None
    if len({(c.width, c.height, c.cx, c.cy, c.fy / c.fx, c.distortion[1:]) for c in cameras}) > 1:
        raise ConfigError("--mount --free lens: give all photos the same calibration, of one zoom")
    focal, k1 = (float(np.median(values)) for values in zip(*((c.fx, c.distortion[0]) for c in cameras), strict=True))
    first = cameras[0]
    return replace(first.zoomed(focal / first.fx), distortion=(k1, *first.distortion[1:]))


def _find(
    file: Path,
    guess: GuessConfig,
    dem: Dem,
    segmenter: Segmenter | None,
    scene: SceneFilter,
    options: PhotoOptions,
    config: Any,
    lens: Camera | None = None,
) -> FoundPhoto:
    from ltm_core.pose_estimation.lens import LensPrior
    from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
    from ltm_core.pose_estimation.skyline.find_pose import find_pose, find_pose_and_lens
    from ltm_core.pose_estimation.skyline.picture_pose_io import doubt_of_sky, read_labels, result_of, set_up_search
    from ltm_core.tracing.trace_io import read_photo

    setup = set_up_search(guess, dem)
    setup = setup if lens is None else replace(setup, camera=lens)
    prior = setup.prior
    if "position" in options.free and prior.position_sigma == 0:
        prior = replace(prior, position_sigma=FREE_POSITION_SIGMA, height_sigma=FREE_POSITION_SIGMA)
    photo = read_photo(file, setup.camera)
    view = scene.look(photo)
    if options.labels is not None:
        labels = read_labels(options.labels, setup.camera)
    else:
        assert segmenter is not None  # nosec B101 # tells the type checker what holds
        labels = segmenter.segment(view.scene(photo)).labels
    doubt = doubt_of_sky(labels, view.hidden)
    if doubt is not None:
        raise ImageError(f"{file}: {doubt}")
    begin = time.process_time()

    def evidence_of(camera: Camera) -> PictureEvidence:
        return picture_evidence(photo, labels, camera, config, view.hidden)

    camera = setup.camera
    if options.lens is not None:
        known = LensPrior.of(options.lens, camera)
        search, camera = find_pose_and_lens(evidence_of, camera, setup.terrain, prior, known, config)
    else:
        search = find_pose(
            evidence_of(camera), setup.terrain, prior, config, FOCAL_SIGMA if "focal" in options.free else 0.0
        )
    result = result_of(search, prior, camera if search.verdict.word == "accepted" else setup.camera)
    spent = time.process_time() - begin
    verdict = search.verdict
    return FoundPhoto(file.name, guess, setup, photo, search, result, verdict.word, verdict.reason, spent)


def _as_one_mount(found: list[FoundPhoto], config: Any, options: PhotoOptions) -> list[FoundPhoto]:
    from ltm_core.pose_estimation.mount.mount_fit import fit_mount
    from ltm_core.pose_estimation.skyline.picture_pose_io import PoseResult

    focal = FOCAL_SIGMA if "focal" in options.free else 0.0
    fit = fit_mount([f.setup.prior for f in found], [f.search for f in found], config, focal_sigma=focal)
    accepted = fit.word == "accepted"
    results = []
    for k, f in enumerate(found):
        covariance = fit.pose_covariance(k) if accepted else f.setup.prior.covariance
        camera = f.setup.camera.zoomed(fit.focal) if accepted else f.setup.camera
        result = PoseResult(fit.poses[k], camera, covariance, accepted)
        results.append(replace(f, result=result, word=fit.word, reason=fit.reason))
    return results


def write_photos(found: list[FoundPhoto], out: Path, picture: Path | None, report: Path | None, folder: bool) -> None:
    """Write pose files, images before and after, and the figures as JSON. `folder`: `out` and `picture` are folders."""
    from ltm_core.pictures import to_png
    from ltm_core.pictures.trace import pose_fit_picture
    from ltm_core.pose_estimation.skyline.picture_pose_io import figures, write_figures_of, write_result

    content = {}
    for f in found:
        place = out / f"{Path(f.name).stem}.yaml" if folder else out
        if f.usable:
            place.parent.mkdir(parents=True, exist_ok=True)
            write_result(place, f.result, f.reason, f.word, f.guess, f.setup.frame)
        content[f.name] = figures(f.search, f.result, f.setup.prior, f.setup.frame) | {
            "verdict": f.word,
            "reason": f.reason,
            "cpu_seconds": f.seconds,
        }
        if picture is None:
            continue
        camera, prior = f.setup.camera, f.setup.prior.pose
        poses = [("as given", camera, prior)]
        if f.result.accepted:
            poses.append((f"found ({f.word})", f.result.camera, f.result.pose))
        elif f.search.hypotheses:
            best = f.search.hypotheses[0].refined
            poses.append((f"best, not accepted: {f.word}", camera, best.pose))
        at = picture / f"{Path(f.name).stem}.png" if folder else picture
        at.parent.mkdir(parents=True, exist_ok=True)
        at.write_bytes(to_png(pose_fit_picture(f.photo, camera, f.search.horizon, poses)))
    if report is not None:
        report.parent.mkdir(parents=True, exist_ok=True)
        write_figures_of(report, content if folder else next(iter(content.values())))
