"""`ltm pose photo`: find the poses of photos from their skylines and ridges."""

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from typer import Argument, Option

from ltm_core.base.errors import ConfigError, ImageError
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.pictures import to_png
from ltm_core.pictures.trace import pose_fit_picture
from ltm_core.pose_estimation.lens import LensPrior
from ltm_core.pose_estimation.mount.mount_fit import fit_mount
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, find_pose, find_pose_and_lens
from ltm_core.pose_estimation.skyline.picture_pose_config import BARE_EARTH, CANOPY_SURFACE, CrestCover
from ltm_core.pose_estimation.skyline.picture_pose_io import (
    PoseResult,
    SearchSetup,
    doubt_of_sky,
    figures,
    read_labels,
    result_of,
    set_up_search,
    write_result,
)
from ltm_core.raster.dem import Dem
from ltm_core.storage.config_io import checked, load_yaml
from ltm_core.storage.disk_io import require_files, require_folder
from ltm_core.storage.image_io import read_rgb
from ltm_core.tracing.trace_io import GuessConfig, read_photo
from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_core.vision.masks import MaskMaker
from ltm_core.vision.scene_view import SceneFilter
from ltm_core.vision.segmenter import Segmenter
from ltm_ros.cli.output import Crs, Dems, Overwrite, open_dems, print_table, say, warn
from ltm_ros.cli.pose_points import lens_kind, parameter_names
from ltm_ros.recordings.importing.photo import read_pose_file

NOT_ACCEPTED = 3
"""Exit code of a search whose result is not accepted."""
FOCAL_SIGMA = 0.05
"""Relative standard deviation of a focal length to fit; the search covers twice this."""
FREE_POSITION_SIGMA = 10.0
"""Standard deviation in metres of a position to fit that states none."""


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
    photo: Annotated[Path, Argument(metavar="PHOTO", help="Photo, or with a photo list a folder of photos.")],
    guess: Annotated[Path, Option(metavar="FILE", help="Pose file, or photo list (CSV), with what is known.")],
    dem: Dems,
    out: Annotated[Path, Option("--out", "-o", metavar="FILE", help="Pose file; with a photo list, a folder.")],
    mount: Annotated[bool, Option("--mount", help="Find one correction of all photos of a camera.")] = False,
    free: Annotated[str, Option(metavar="NAMES", help="Fit focal, position, lens[:phone|ptz|action|slr].")] = "none",
    labels: Annotated[Path | None, Option(metavar="FILE", help="PNG of class ids in place of the network.")] = None,
    mask: Annotated[Path | None, Option(metavar="FILE", help="Mask (`ltm mask`); ignores non-zero pixels.")] = None,
    model: Annotated[str, Option(metavar="NAME", help="Segmentation network. Default: the shipped one.")] = "",
    canopy: Annotated[bool, Option("--canopy", help="The DEM includes tree tops (a surface model).")] = False,
    picture: Annotated[Path | None, Option(metavar="FILE", help="PNG of terrain lines, before and after.")] = None,
    report: Annotated[Path | None, Option(metavar="FILE", help="JSON with residuals, verdict and covariance.")] = None,
    crs: Crs = None,
    overwrite: Overwrite = False,
) -> None:
    """Find a camera's pose from the skyline and ridges in its photo.

    Exit code 3: a pose was not accepted. An ambiguous one, or one without a stated azimuth, is not written."""
    many = photo.is_dir()
    if many:
        require_folder(out)
    require_files([place for place in (None if many else out, report, None if many else picture) if place], overwrite)
    chosen = parameter_names(free)
    lens = lens_kind(chosen)
    if set(chosen) - {"focal", "position"}:
        raise ConfigError(f"--free {free}: a skyline fits focal, position and lens")
    guesses = _guesses_of(photo, guess) if many else {photo: load_yaml(guess, GuessConfig)}
    search = _PhotoSearch(
        open_dems(dem, crs),
        Segmenter.open(model or DEFAULT_MODEL) if labels is None else labels,
        SceneFilter(None if mask is None else MaskMaker(mask, "--mask")),
        CANOPY_SURFACE if canopy else BARE_EARTH,
        FOCAL_SIGMA if "focal" in chosen else 0.0,
        "position" in chosen,
    )
    found = [search.find(file, known, lens) for file, known in guesses.items()]
    if mount and lens is not None:
        shared = _common_lens([f.result.camera for f in found if f.result.accepted])
        found = [search.find(file, known, None, shared) for file, known in guesses.items()]
    if mount:
        found = search.as_one_mount(found)
    _write(found, out, picture, report, many)
    rows = []
    for f in found:
        angles, given = f.result.pose.angles_deg, f.setup.prior.pose.angles_deg
        moved = ((angles[0] - given[0] + 180) % 360 - 180, angles[1] - given[1], angles[2] - given[2])
        cells = ["-"] * 5
        if f.usable:
            sigma = ", ".join(f"{s:.2f}" for s in f.search.verdict.sigma_deg) if f.result.accepted else "as given"
            cells = [*(f"{a:.3f}" for a in angles), sigma, ", ".join(f"{m:+.2f}" for m in moved)]
        rows.append((f.name, f.word, *cells))
    columns = ("photo", "verdict", ">azimuth", ">pitch", ">roll", "sigma, deg", "difference from the input")
    print_table("poses", columns, rows)
    for f in found:
        if not f.result.accepted:
            kept = "the given pose is kept" if f.usable else "no pose was written"
            uncalibrated = not lens and not any(f.setup.camera.distortion)
            fix = "; if the lens is not calibrated, --free lens fits it" if uncalibrated else ""
            warn(f"{f.name}: {f.word}, {kept}: {f.reason}{fix}")
    if any(f.usable for f in found):
        say(f"  {out}")
    if not all(f.result.accepted for f in found):
        raise typer.Exit(NOT_ACCEPTED)


def _guesses_of(photos: Path, poses: Path) -> dict[Path, GuessConfig]:
    """Return the photos of a folder that a photo list names, with their known values. Raises ConfigError."""
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


@dataclass(frozen=True, eq=False)
class _PhotoSearch:
    """What is the same for all photos of a command. `source`: the network, or a file of labels; `focal_sigma`: relative
    standard deviation of the focal length, 0 if it is known."""

    dem: Dem
    source: Segmenter | Path
    scene: SceneFilter
    cover: CrestCover
    focal_sigma: float
    free_position: bool

    def find(self, file: Path, guess: GuessConfig, lens: str | None, camera: Camera | None = None) -> FoundPhoto:
        """Search the pose of a photo. `lens`: kind of lens whose focal length and k1 are fitted; `camera`: replaces
        that of the guess."""
        setup = set_up_search(guess, self.dem, self.cover)
        setup = setup if camera is None else replace(setup, camera=camera)
        prior = setup.prior
        if self.free_position and prior.position_sigma == 0:
            prior = replace(prior, position_sigma=FREE_POSITION_SIGMA, height_sigma=FREE_POSITION_SIGMA)
        photo = read_photo(file, setup.camera)
        view = self.scene.look(photo)
        if isinstance(self.source, Path):
            labels = read_labels(self.source, setup.camera)
        else:
            labels = self.source.segment(view.scene(photo)).labels
        if (doubt := doubt_of_sky(labels, view.hidden)) is not None:
            raise ImageError(f"{file}: {doubt}")
        begin = time.process_time()

        def evidence_of(camera: Camera) -> PictureEvidence:
            return picture_evidence(photo, labels, camera, view.hidden)

        found = setup.camera
        if lens is not None:
            known = LensPrior.of(lens, found)
            search, found = find_pose_and_lens(evidence_of, found, setup.terrain, prior, known)
        else:
            search = find_pose(evidence_of(found), setup.terrain, prior, self.focal_sigma)
        verdict = search.verdict
        result = result_of(search, prior, found if verdict.word == "accepted" else setup.camera)
        spent = time.process_time() - begin
        return FoundPhoto(file.name, guess, setup, photo, search, result, verdict.word, verdict.reason, spent)

    def as_one_mount(self, found: list[FoundPhoto]) -> list[FoundPhoto]:
        """Return the photos with the poses that one correction of all of them gives."""
        priors, searches = [f.setup.prior for f in found], [f.search for f in found]
        fit = fit_mount(priors, searches, focal_sigma=self.focal_sigma)
        accepted = fit.word == "accepted"
        results = []
        for k, f in enumerate(found):
            covariance = fit.pose_covariance(k) if accepted else f.setup.prior.covariance
            camera = f.setup.camera.zoomed(fit.focal) if accepted else f.setup.camera
            result = PoseResult(fit.poses[k], camera, covariance, accepted)
            results.append(replace(f, result=result, word=fit.word, reason=fit.reason))
        return results


def _common_lens(cameras: list[Camera]) -> Camera | None:
    """Return a camera with the median focal length and k1; None without cameras. Raises ConfigError if the photos were
    not taken by one lens at one zoom."""
    if not cameras:
        return None
    if len({(c.width, c.height, c.cx, c.cy, c.fy / c.fx, c.distortion[1:]) for c in cameras}) > 1:
        raise ConfigError("--mount --free lens: give all photos the same calibration, of one zoom")
    focal, k1 = (float(np.median(values)) for values in zip(*((c.fx, c.distortion[0]) for c in cameras), strict=True))
    first = cameras[0]
    return replace(first.zoomed(focal / first.fx), distortion=(k1, *first.distortion[1:]))


def _write(found: list[FoundPhoto], out: Path, picture: Path | None, report: Path | None, folder: bool) -> None:
    """Write pose files, images before and after, and the figures as JSON. `folder`: `out` and `picture` are folders."""
    content = {}
    for f in found:
        place = out / f"{Path(f.name).stem}.yaml" if folder else out
        if f.usable:
            place.parent.mkdir(parents=True, exist_ok=True)
            write_result(place, f.result, f.reason, f.word, f.guess, f.setup.frame)
        verdict = {"verdict": f.word, "reason": f.reason, "cpu_seconds": f.seconds}
        content[f.name] = figures(f.search, f.result, f.setup.prior, f.setup.frame) | verdict
        if picture is None:
            continue
        poses = [("as given", f.setup.camera, f.setup.prior.pose)]
        if f.result.accepted:
            poses.append((f"found ({f.word})", f.result.camera, f.result.pose))
        elif f.search.hypotheses:
            poses.append((f"best, not accepted: {f.word}", f.setup.camera, f.search.hypotheses[0].refined.pose))
        at = picture / f"{Path(f.name).stem}.png" if folder else picture
        at.parent.mkdir(parents=True, exist_ok=True)
        at.write_bytes(to_png(pose_fit_picture(f.photo, f.setup.camera, f.search.horizon, poses)))
    if report is not None:
        report.parent.mkdir(parents=True, exist_ok=True)
        said = content if folder else next(iter(content.values()))
        report.write_text(json.dumps(said, indent=1, allow_nan=False) + "\n", encoding="utf-8")
