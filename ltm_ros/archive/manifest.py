"""List the frames of an archive: location, content, pose and calibration.

Poses and calibrations are joined here by the same rules as live (`FrameJoin`), so that frames can come in any order."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, field
from functools import lru_cache
from pathlib import Path

from ltm_core.base.errors import ArchiveError, LtmError, RecordingError
from ltm_core.base.number_text import DAY_NS
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.site.site import Site
from ltm_msgs_py.bag.cdr import RAW_TYPE, Picture, picture_of
from ltm_msgs_py.bag.reader import BagReader, by_log_time
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose, pose_to_msg
from ltm_ros.archive.scan import Scan, picture_digest
from ltm_ros.recordings.inputs import decoded_input
from ltm_ros.runtime.frame_join import FrameJoin, FrameJoinConfig, JoinedFrame
from ltm_ros.runtime.health import Health, cause_of, too_large
from ltm_ros.runtime.stamp_check import StampCheck
from ltm_ros.runtime.topics import camera_topic


@dataclass(frozen=True, eq=False)
class ArchiveFrame:
    """A usable frame: file, topic, log time and digest (`content`) of its image; `covariance` (6, 6): of the pose."""

    camera: str
    stamp_ns: int
    file: str
    topic: str
    log_time_ns: int
    size_bytes: int
    content: str
    calibration: Camera
    pose: Pose
    covariance: Float64Array

    @property
    def day(self) -> int:
        """Return whole days since 1970, UTC."""
        return self.stamp_ns // DAY_NS

    def identity(self) -> list[object]:
        """Return everything that its votes depend on besides the site, without its location."""
        numbers = (self.pose.position, self.pose.rotation, self.covariance)
        return [self.stamp_ns, self.content, astuple(self.calibration), *(values.tolist() for values in numbers)]


@dataclass(frozen=True)
class Failure:
    """Failures of one kind: place, count, and reason with the remedy."""

    place: str
    cause: str
    why: str
    count: int = 1


@dataclass
class ArchiveManifest:
    """`frames` by camera and stamp. `unread`: recordings that could not be read. `failures`: frames lost so far.
    `repeated`: number of duplicate frames. `unchanged`: images that repeat a camera's previous one, which are no frames
    if the site has `drop_repeated`. `damage`: of files, in words. `recorded`: types of all topics of the archive."""

    frames: list[ArchiveFrame] = field(default_factory=list)
    unread: list[Failure] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    repeated: int = 0
    unchanged: int = 0
    damage: list[str] = field(default_factory=list)
    recorded: dict[str, str] = field(default_factory=dict)


def make_manifest(
    scans: Sequence[Scan], site: Site, cameras: Sequence[str], rules: FrameJoinConfig, limits: tuple[float, float]
) -> ArchiveManifest:
    """List the frames of these cameras. `limits`: seconds by which a stamp may be ahead of and behind its log time.
    Raises ArchiveError for a site whose poses depend on the order of frames."""
    if site.refine_poses is not None:
        what = f"site {site.name} refines poses (refine_poses), so that they depend on earlier frames"
        raise ArchiveError(f"{what}: remove the section for the archive, and write poses into the site file")
    manifest = ArchiveManifest(damage=[note for scan in scans for note in scan.damage])
    for scan in scans:
        manifest.recorded |= scan.recorded
        if unknown := scan.lost.get("", 0):
            manifest.failures.append(Failure(scan.name, "damage", "; ".join(scan.damage), unknown))
    for camera in cameras:
        _join_camera(scans, site, camera, rules, limits, manifest)
    manifest.frames.sort(key=lambda frame: (frame.camera, frame.stamp_ns))
    return manifest


def _join_camera(
    scans: Sequence[Scan],
    site: Site,
    camera: str,
    rules: FrameJoinConfig,
    limits: tuple[float, float],
    manifest: ArchiveManifest,
) -> None:
    health, frames = Health(), dict[int, ArchiveFrame]()
    log_time = 0
    stamps = StampCheck(lambda: log_time, health, *limits)
    last = ""

    def complete(joined: JoinedFrame) -> None:
        file, image = joined.image
        join.check_size(image.size, joined.camera)
        # As nodes receive them, through a message.
        sent = pose_to_msg(joined.pose, image.stamp_ns, "map", joined.covariance)
        pose, covariance = msg_to_pose(sent, "map"), msg_to_covariance(sent, join.assumed)
        assert covariance is not None  # nosec B101 # some is assumed
        place = camera, image.stamp_ns, file, image.topic, image.log_time_ns, image.size_bytes
        frames[image.stamp_ns] = ArchiveFrame(*place, image.content, joined.camera, pose, covariance)

    join = FrameJoin(site, camera, rules, complete, health, lambda image: (image[1].stamp_ns, image[1].size))
    images = {camera_topic(site.name, camera, topic) for topic in join.image_topics}
    topics = {camera_topic(site.name, camera, topic): topic for topic in join.others}
    others = dict(zip(topics, join.others.values(), strict=True))
    known: dict[int, str] = {}
    wanted = {*images, *others}
    begins = [min((scan.begins[t] for t in wanted & scan.begins.keys()), default=None) for scan in scans]
    for number, message in by_log_time(begins, lambda n: scans[n].messages(wanted)):
        file, log_time = scans[number].name, message.log_time_ns
        try:
            if message.trouble:
                raise RecordingError(message.trouble)
            if message.topic not in images:
                others[message.topic](decoded_input(topics[message.topic], message.raw, message.type_name))
                continue
            what = f"an image of {camera}"
            if message.stamp_ns in known:
                manifest.repeated += 1
                if known[message.stamp_ns] != message.content:
                    health.drop("two_pictures", f"{file} has a different image with stamp {message.stamp_ns} ns; "
                                                "the first is used: remove the wrong archive")  # fmt: skip
            elif not stamps.refuses(what, message.stamp_ns) and not too_large(
                health, site.limits, message.type_name == RAW_TYPE, message.size_bytes, message.size
            ):
                known[message.stamp_ns] = message.content
                same, last = message.content == last, message.content
                if same:
                    manifest.unchanged += 1
                    if rules.drop_repeated:
                        continue
                join.add("image", message.stamp_ns, (file, message))
        except LtmError as error:
            health.drop(cause_of(error), f"{error} ({file}, log time {message.log_time_ns} ns)")
    join.finish()
    for scan in scans:
        if lost := sum(scan.lost.get(name, 0) for name in images):
            health.drop("damage", "; ".join(scan.damage), lost)
    manifest.frames += frames.values()
    reasons = health.summary()
    for cause, count in health.dropped.items():
        manifest.failures.append(Failure(camera, cause, reasons.get(f"reason.{cause}", ""), count))


_HELD = 4
"""Maximum number of open recordings: recordings of one time overlap little."""


class ArchiveImageReader:
    """Reads images by file, topic and log time: of a recording of many cameras, only the chunks that hold them."""

    def __init__(self) -> None:
        self._opened = lru_cache(_HELD)(BagReader)

    def read(self, frame: ArchiveFrame) -> Picture:
        """Read an image. Raises ArchiveError if the file is missing, no longer has the image or cannot be read now."""
        name, at = frame.file, frame.log_time_ns
        try:
            reader = self._opened(Path(name))
        except RecordingError as error:
            raise ArchiveError(f"{error}; it existed when the archive was scanned") from error
        for message in reader.messages([frame.topic], at, at + 1):
            try:
                picture = picture_of(message.raw, message.type_name)
            except LtmError:  # of the same time, and not ours, which was one when it was found
                continue
            if (picture.stamp_ns, picture_digest(picture)) == (frame.stamp_ns, frame.content):
                return picture
        if reader.unread:
            raise ArchiveError(f"{name} cannot be read now: {'; '.join(reader.unread)}")
        what = f"{name} no longer contains the image of {frame.topic} at log time {at} ns"
        raise ArchiveError(f"{what}: the file has changed; run again")
