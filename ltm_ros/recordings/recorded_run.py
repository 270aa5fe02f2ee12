"""Open a recorded run: its bag, site, frames, votes and final map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.base.resources import config_path, project_path
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_ros.recordings.frame_stream import FrameStream, StreamedFrame
from ltm_ros.runtime.topics import FUEL_MAP, site_topic

FUEL_TRUTH = "fuel_truth.tif"


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """Inputs and results of a frame: `photo` (H, W, 3), `depth` traced and `labels`, (H, W) each; `fused` depth if the
    site has a depth network.
    """

    camera_name: str
    stamp_ns: int
    camera: Camera
    pose: Pose
    photo: UInt8Array
    depth: Float32Array
    labels: UInt8Array
    fused: Float32Array | None = None


@dataclass(frozen=True)
class Recorded:
    """A bag with its site and the folder that may hold its truth rasters."""

    bag: Path
    site_path: Path
    site: Site
    truth: Path
    date: str | None = None
    """Date of a simulated site with several: `truth/DATE/` in the truth folder holds its rasters."""

    @classmethod
    def find(cls, bag: Path, site: Path | None = None, truth: Path | None = None, date: str | None = None) -> Recorded:
        """Find the site: as given, beside or in the bag, or the shipped one with the cameras of the topics; and truth:
        the site's folder.

        Raises RecordingError without a site or date, ConfigError for an invalid site.
        """
        path = site or _site_of(bag)
        folder = truth or path.resolve().parent
        dates = sorted(p.name for p in (folder / "truth").glob("*") if p.is_dir())
        if date is None and len(dates) > 1:
            raise RecordingError(f"{folder} contains the truth of {', '.join(dates)}: give the bag's date with --date")
        if date is not None and date not in dates:
            raise RecordingError(f"{folder} contains no truth of {date!r}; it has {', '.join(dates) or 'none'}")
        return cls(bag, path, load_site(path), folder, date)

    @property
    def life_forms(self) -> Path | None:
        """Return the raster of true class ids on the fuel grid, if any."""
        dated = None if self.date is None else self.truth / "truth" / self.date / "life_form.tif"
        return next((file for file in (dated, self.truth / FUEL_TRUTH) if file is not None and file.is_file()), None)

    @property
    def surfaces(self) -> tuple[Path | None, Path | None]:
        """Return the rasters of the true surface at the bag's date and at the previous one, if any."""
        if self.date is None:
            return None, None
        folder = self.truth / "truth"
        before = [path.stem.split("_")[1] for path in folder.glob(f"change_*_{self.date}.tif")]
        rasters = [folder / name / "surface.tif" for name in (self.date, *before[:1])]
        now, *earlier = [raster if raster.is_file() else None for raster in rasters]
        return now, earlier[0] if earlier else None

    def stream(self) -> FrameStream:
        return FrameStream.open(self.bag, self.site)


def recorded_frames(bag: Path, site: Site) -> Iterator[RecordedFrame]:
    """Yield the frames of a recorded run with depth and labels, camera by camera, in time order.

    A frame is returned as soon as the bag has given all of it, so a bag of hours needs the memory of a few frames.
    """
    stream = FrameStream.open(bag, site)
    for camera in site.cameras:
        for frame in stream.frames(("depth_camera", "pose", "photo", "traced", "labels"), [camera]):
            parts = (frame.take(part) for part in ("depth_camera", "pose", "photo", "traced", "labels", "fused"))
            yield RecordedFrame(camera, frame.stamp_ns, *parts)


def _site_of(bag: Path) -> Path:
    folder = bag.resolve()
    for place in (folder, folder.parent, folder.parent.parent):
        if (place / "site.yaml").is_file():
            return place / "site.yaml"
    names = {topic.split("/")[1] for topic in BagReader(bag).topics() if topic.count("/") > 2}
    for name in sorted(names):
        for shipped in (f"bags/{name}/site.yaml", f"config/sites/{name}.yaml"):
            try:
                return project_path(shipped)
            except LtmError:
                continue
    raise RecordingError(
        f"{bag}: no site.yaml beside it, and no shipped site has the cameras {', '.join(sorted(names))}: give --site"
    )


def image_shape(frame: StreamedFrame, site: Site) -> tuple[int, int]:
    """Return rows and columns of a frame's image. Raises RecordingError if unknown."""
    camera: Camera | None = frame.take("camera") or frame.take("depth_camera")
    if camera is None and (calibration := site.cameras[frame.camera_name].calibration) is not None:
        camera = calibration.camera()
    if camera is None:
        raise RecordingError(
            f"frame {frame.stamp_ns} of {frame.camera_name} has no camera_info, and site {site.name} has no "
            "calibration: record camera_info, too"
        )
    return camera.height, camera.width


def recorded_votes(recorded: Recorded, geometry: GridGeometry, labels: LabelSet) -> Iterator[CellVotes]:
    """Yield the votes of a bag, frame by frame; `geometry`: the fuel grid in the map frame. Raises MessageError."""
    for frame in recorded.stream().frames(["votes"]):
        yield msg_to_votes(frame.take("votes"), geometry, labels.names, frame.camera_name)


def last_fuel_map(bag: Path, site: Site) -> tuple[UInt8Array, GridGeometry, LabelSet]:
    """Return class ids (255 unseen), geometry in the site's CRS, and the label set. Raises RecordingError if there is
    no map.
    """
    reader = BagReader(bag)
    topic = site_topic(site.name, FUEL_MAP)
    last = None
    for message in reader.messages([topic]):
        last = message
    if last is None:
        raise RecordingError(f"{bag} has no {topic}; its topics are {', '.join(sorted(reader.topics())) or '(none)'}")
    classes, geometry = msg_to_classes(reader.decode(last))
    return classes, site.in_crs(geometry), LabelSet.load(config_path(site.labels))
