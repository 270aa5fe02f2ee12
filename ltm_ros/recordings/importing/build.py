"""Build a bag from photos, for `ltm import`."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ltm_core.base.errors import ConfigError, ImageError, LtmError, RecordingError
from ltm_core.cameras.plausibility import doubt_of_radians
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.site.site import Site
from ltm_core.storage.config_io import checked
from ltm_msgs_py.bag.cdr import TF_TYPE, CameraFrames
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.recordings.importing.assumptions import Assumptions, Surroundings
from ltm_ros.recordings.importing.georeference import PlacedPhoto, place
from ltm_ros.recordings.importing.photo import ImportedImage, PhotoPose, read_pose_file
from ltm_ros.recordings.importing.pictures import SkippedFile, find_pictures
from ltm_ros.recordings.importing.refinement import PoseRefinement, Refinement
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, POSE, camera_topic

_APART_NS = 1_000_000
"""Interval in ns by which photos of one camera with equal stamps (bursts) are moved apart."""
_Placed = tuple[str, ImportedImage, PhotoPose, int]
"""A photo that can be placed: its camera, file, row in the pose file, and stamp."""


@dataclass
class ImportReport:
    """Result of an import. `rejected`: (photo, why). `skipped`: other files. `cameras`: photos per camera."""

    bag: Path
    site: str
    crs: str
    origin: tuple[float, float]
    cameras: dict[str, int] = field(default_factory=dict)
    rejected: list[tuple[Path, str]] = field(default_factory=list)
    skipped: list[SkippedFile] = field(default_factory=list)
    notes: list[tuple[str, str]] = field(default_factory=list)
    refined: list[tuple[str, Refinement]] = field(default_factory=list)
    """Results for photos whose pose was searched in the image."""


def import_photos(
    images: Sequence[Path],
    out: Path,
    poses: Path | None = None,
    site: Site | None = None,
    camera: str | None = None,
    assumed: Assumptions | None = None,
    skip_bad: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
    refinement: PoseRefinement | None = None,
) -> ImportReport:
    """Write a bag with image_raw/compressed, camera_info and pose with covariance of every photo, by their stamps.

    `images`: photo files, folders of photos, and recordings of phones (`find_pictures`). With `poses`, only photos
    listed there are used. `site`: frame, DEM, and the cameras, of which fixed ones have pose and calibration there;
    without it the frame is the UTM zone of the first photo, with an origin near it. `camera`: for photos whose row
    names none; by default the site's only camera. `skip_bad`: skip photos that cannot be imported, instead of stopping.
    `progress(done, total)`: each photo is read twice, to place it and to write it. `refinement`: finds the photos'
    poses in their images.

    Raises LtmError children, each with photo, value and remedy; the bag is not begun unless every photo is placed."""
    assumed = assumed or Assumptions()
    BagWriter.require_free(out)
    if site is not None:
        around = Surroundings(site.frame, site.open_dem(), site.cameras, site.assumed_pose_error)
    files, skipped = find_pictures(images, assumed)
    listed = [(file, PhotoPose(name=file.name)) for file in files]
    if poses is not None:
        listed = _listed(files, poses)
        chosen = {file.name for file, _ in listed}
        skipped += [SkippedFile(file.path, f"not listed in {poses}") for file in files if file.name not in chosen]
    if site is None:
        around = Surroundings(_frame_of(listed))
    frame = around.frame
    report = ImportReport(out, site.name if site is not None else "site", frame.crs, (frame.x_origin, frame.y_origin))
    report.skipped = skipped

    placed: list[_Placed] = []
    for done, (file, row) in enumerate(listed):
        try:
            name = _camera_name(row, camera, site)
            item = place(file.read(), row, name, around, assumed)
            _check_size(item, name, site)
        except ConfigError:
            raise
        except LtmError as error:
            if not skip_bad:
                raise
            report.rejected.append((file.path, str(error)))
        else:
            if refinement is not None:
                refinement.look(name, file.name, item)
            # Only the order of the photos is kept: a season's photos do not fit in memory.
            placed.append((name, file, row, item.stamp_ns))
            report.notes += [(file.name, note) for note in item.notes]
        progress(done + 1, 2 * len(listed))
    if not placed:
        raise RecordingError(f"none of {len(listed)} photos could be imported; the first: {report.rejected[0][1]}")
    placed = _apart(placed, report)
    doubt = doubt_of_radians([azimuth for _, _, row, _ in placed if (azimuth := row.pose.azimuth_deg) is not None])
    if doubt is not None:
        report.notes.append((str(poses), doubt))

    origin = f"{frame.x_origin!r} {frame.y_origin!r}"
    custom = {"ltm_source": "photos", "ltm_site": report.site, "ltm_crs": frame.crs, "ltm_origin": origin}
    with BagWriter(out, custom_data=custom) as writer:
        frames = CameraFrames({camera_topic(report.site, name, POSE): name for name, *_ in placed})
        for done, (name, file, row, stamp_ns) in enumerate(placed):
            item = place(file.read(), row, name, around, assumed)
            if refinement is not None:
                item, found = refinement.refine(name, file.name, item)
                report.refined.append((file.name, found))
            _write(writer, report.site, name, item, stamp_ns, frames)
            report.cameras[name] = report.cameras.get(name, 0) + 1
            progress(len(listed) + done + 1, len(listed) + len(placed))
    return report


def _write(writer: BagWriter, site: str, camera: str, item: PlacedPhoto, stamp_ns: int, frames: CameraFrames) -> None:
    optical = f"{camera}_optical"
    image = compressed_to_msg(item.photo.data, item.photo.image_format, stamp_ns, optical)
    for topic, msg in (
        (CAMERA_INFO, camera_to_msg(item.camera, stamp_ns, optical)),
        (POSE, pose_to_msg(item.pose, stamp_ns, covariance=item.covariance)),
        (IMAGE_COMPRESSED, image),
    ):
        writer.write(name := camera_topic(site, camera, topic), msg, stamp_ns)
        for transforms, raw, latched in frames.beside(name, msg):
            writer.add_topic(transforms, TF_TYPE, latched)
            writer.write_raw(transforms, TF_TYPE, raw, stamp_ns)


def _listed(files: list[ImportedImage], poses: Path) -> list[tuple[ImportedImage, PhotoPose]]:
    """Return the photos that a pose file lists, by their names with or without suffix, each with its row."""
    rows = read_pose_file(poses)
    named = [(file, name) for file in files for name in (file.name, Path(file.name).with_suffix("").as_posix())]
    missing = sorted(rows.keys() - {name for _, name in named})
    if missing:
        raise RecordingError(f"pose file {poses} lists {len(missing)} missing photos: {', '.join(missing[:5])}")
    found = {file.name: (file, rows[name]) for file, name in reversed(named) if name in rows}
    return [found[file.name] for file in files if file.name in found]


def _camera_name(row: PhotoPose, given: str | None, site: Site | None) -> str:
    name = row.camera or given
    if site is None:
        return checked(PhotoPose, {"name": "-", "camera": name or "camera"}, "--camera").camera or ""
    if name is None:
        if len(site.cameras) > 1:
            what = f"site {site.name} has the cameras {', '.join(site.cameras)}"
            raise ConfigError(f"{what}: name the photos' with --camera or a column `camera` in the pose file")
        (name,) = site.cameras
    site.camera(name)
    return name


def _check_size(item: PlacedPhoto, name: str, site: Site | None) -> None:
    """Raise ImageError for a photo that is too large for the graph, or of another size than the site's calibration."""
    if site is None:
        return
    calibration, photo = site.camera(name).calibration, item.photo
    if photo.width * photo.height > site.limits.pixels:
        raise ImageError(
            f"{photo.path} has {photo.width} x {photo.height} pixels, but the site's limit is {site.limits.pixels}: "
            "reduce the photo, or raise pixels under `expert.limits`"
        )
    if calibration is None or (calibration.width, calibration.height) == (photo.width, photo.height):
        return
    why = f"has {photo.width} x {photo.height} pixels" + (f", as {photo.turned}," if photo.turned else "")
    remedy = "use a photo of that size, or give the site this photo's calibration"
    if photo.turned and (calibration.height, calibration.width) == (photo.width, photo.height):
        remedy = "give the site the upright image's calibration, pitch and roll, or remove the photo's orientation tag"
    size = f"{calibration.width} x {calibration.height}"
    raise ImageError(f"{photo.path} {why} but the site's camera {name} is calibrated for {size}: {remedy}")


def _frame_of(listed: list[tuple[ImportedImage, PhotoPose]]) -> SiteFrame:
    """Return the UTM zone of the first photo with a position, with an origin on the nearest kilometre."""
    why = ""
    unreadable: LtmError | None = None
    for file, row in listed:
        if row.pose.x is not None and row.pose.crs is None:
            raise ConfigError(f"{file.name} has x, y in the pose file: give their site with --site")
        lon, lat = row.pose.lonlat()
        if lon is None or lat is None:
            try:
                sensed = file.read().sensed
            except LtmError as error:  # it is reported when it is placed
                unreadable = unreadable or error
                continue
            lon, lat, why = sensed.lon, sensed.lat, why or sensed.missing
        if lon is not None and lat is not None:
            zone = min(math.floor((lon + 180) / 6) + 1, 60)
            crs = f"EPSG:{32600 + zone if lat >= 0 else 32700 + zone}"
            x, y = SiteFrame(crs).from_lonlat(lon, lat)
            return SiteFrame(crs, round(float(x), -3), round(float(y), -3))
    if unreadable is not None:
        raise unreadable
    reason = f" ({why})" if why else ""
    raise RecordingError(f"no photo has a position{reason}: give them x, y or lon, lat in a pose file (--poses)")


def _apart(placed: list[_Placed], report: ImportReport) -> list[_Placed]:
    """Sort by stamp, and make the stamps of each camera unique."""
    last: dict[str, int] = {}
    result = []
    for name, file, row, stamp_ns in sorted(placed, key=lambda item: (item[3], item[1].name)):
        if name in last and stamp_ns <= last[name]:
            stamp_ns = last[name] + _APART_NS
            report.notes.append((file.name, "has the same stamp as the previous photo: moved by 1 ms"))
        last[name] = stamp_ns
        result.append((name, file, row, stamp_ns))
    return sorted(result, key=lambda item: item[3])
