"""Measure the labels of a network on recordings of a site, or on labelled photos, for `ltm models measure`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_core.base.types import Float64Array
from ltm_core.fuel import label_errors
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.pose import Pose
from ltm_core.label_heads.head_fit import balanced
from ltm_core.label_heads.labelled_frames import evenly, read_frames
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep, TracingConfig, TracingStep, VotingStep
from ltm_core.pipeline.site_fuel import measured_errors
from ltm_core.scoring.labels import SegmentationScore
from ltm_core.site.networks import label_network
from ltm_core.site.site import Site
from ltm_core.vision.label_head import find_label_head
from ltm_core.vision.manifest import DEFAULT_MODEL, SHIPPED_LABEL_HEAD, NetworkManifest
from ltm_core.vision.segmenter import Segmenter
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_ros.recordings.frame_stream import PARTS, FrameStream
from ltm_ros.runtime.topics import POSE, POSED_POSE

MOST_FRAMES: Final = 240
"""Maximum number of frames that are measured, evenly spread over the recordings: some minutes."""
_POSE: Final = "pose"


def measure_network(
    model: str,
    site: Site | None,
    bags: Sequence[Path],
    photos: Path | None,
    head: str = SHIPPED_LABEL_HEAD,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[Path, label_errors.LabelErrors]:
    """Measure the labels of a network with a label head and write their record; return its path, and the label errors
    that it states.

    Raises ConfigError without anything to measure on or without a prior map, RecordingError for recordings without
    posed images, ImageError for too few cells, and as the steps of a frame do."""
    heads = None if site is None else site.label_heads
    manifest = NetworkManifest.find(model if site is None else label_network(site, model)).serving(head)
    file = find_label_head(head, manifest, heads)
    about: dict[str, Any] = {}
    sources: list[str] = []
    if site is not None and bags:
        errors = _on_recordings(model, site, bags, head, progress)
        about |= dict(label_errors.record_of(errors, errors.source, site=site.name))
        sources.append(about.pop("source"))
    if photos is not None:
        segmenter = Segmenter.open(manifest, head=head, heads=heads)
        frames = read_frames(photos, len(segmenter.labels))
        score = SegmentationScore.empty(len(segmenter.labels))
        for frame in frames:
            score = score.plus(frame.labels, segmenter.segment(frame.image).labels)
        about["shares"] = label_errors.shares_of(segmenter.labels.names, balanced([score.confusion]))
        about["photos"] = sum(not frame.rendered for frame in frames)
        sources.append(f"labels of {len(frames)} photos of {photos.resolve().name}")
    if not sources:
        raise ConfigError("nothing to measure on; give --site and a recording of it, or --photos")
    about |= {"network": manifest.name, "labels": label_errors.labels_digest(manifest, file)}
    record = label_errors.ReliabilityRecord(**about | {"source": "; ".join(sources)})
    return label_errors.write_record(record), record.errors()


def _on_recordings(
    model: str, site: Site, bags: Sequence[Path], head: str, progress: Callable[[int, int], None]
) -> label_errors.LabelErrors:
    labels = {label_errors.labels_digest(NetworkManifest.find(name)) for name in (model, DEFAULT_MODEL)}
    known = head == SHIPPED_LABEL_HEAD and len(labels) == 1  # it is the default network
    networks = {"own": model} if known else {"own": model, "known": DEFAULT_MODEL}
    votes, steps = _votes(site, bags, networks, head, progress)
    reference = label_errors.known_errors(DEFAULT_MODEL)
    given = (reference, votes.get("known", votes["own"])) if reference.measured else None
    source = f"{len(votes['own'])} frames of site {site.name} against its prior map"
    source += "" if given is None else f" and the changes that {DEFAULT_MODEL} finds"
    return measured_errors(site, steps.geometry, steps.labels, votes["own"], source, given)


def _votes(
    site: Site, bags: Sequence[Path], networks: dict[str, str], head: str, progress: Callable[[int, int], None]
) -> tuple[dict[str, list[CellVotes]], VotingStep]:
    """Return the votes of each network for the frames of all cameras with the label head, and a step that cast them."""
    cameras = [name for name, camera in site.cameras.items() if camera.label_head == head]
    if not cameras:
        raise ConfigError(f"site {site.name} has no camera with label head {head!r}")
    dem = site.open_dem()
    fixed = {name: (c.pose.pose(dem, site.frame), None) for name, c in site.cameras.items() if c.pose is not None}
    calibrations = {name: c.calibration.camera() for name, c in site.cameras.items() if c.calibration is not None}
    streams = [FrameStream(bag, site, _PARTS, cameras) for bag in bags]
    chosen = [
        (f.stamp_ns, place, f.camera_name)
        for place, stream in enumerate(streams)
        for f in stream.frames(["photo"])
        if (_POSE in f or f.camera_name in fixed)
        and ("camera" in f or "depth_camera" in f or f.camera_name in calibrations)
    ]
    if not chosen:
        what = f"{', '.join(map(str, bags))}: no image of {', '.join(cameras)} with pose and calibration"
        raise RecordingError(f"{what}; replay it with `ltm replay RECORDING --record OUT`, and measure OUT")
    wanted = set(evenly(sorted(chosen), MOST_FRAMES))
    tracing = {name: TracingStep(site, name, TracingConfig()) for name in cameras}
    voting = {name: VotingStep(site, name) for name in cameras}
    labelling = {
        (role, name): LabellingStep(_with_head(site, role), name, LabellingConfig(model=network))
        for role, network in networks.items()
        for name in cameras
    }
    votes: dict[str, list[CellVotes]] = {role: [] for role in networks}
    for place, stream in enumerate(streams):
        for frame in stream.frames(["photo"]):
            name, stamp = frame.camera_name, frame.stamp_ns
            if (stamp, place, name) not in wanted:
                continue
            camera = frame.take("camera") or frame.take("depth_camera") or calibrations[name]
            pose, covariance = frame.take(_POSE) or fixed[name]
            depth = tracing[name].trace(camera, pose).ranges.depth()
            assumed = voting[name].assumed if covariance is None else covariance
            for role in networks:
                posed = PosedImage(frame.take("photo"), camera, pose, stamp, name)
                labels, _ = labelling[role, name].label(posed, assumed)
                cast = voting[name].cast(depth, camera, pose, labels, stamp, assumed)
                votes[role].append(voting[name].carried(cast))
            progress(len(votes["own"]), len(wanted))
    return votes, voting[cameras[0]]


def _with_head(site: Site, role: str) -> Site:
    """Return the site for a network's labels; the known network labels without label heads and vocabulary."""
    if role == "own":
        return site
    cameras = {n: c.model_copy(update={"label_head": SHIPPED_LABEL_HEAD}) for n, c in site.cameras.items()}
    return site.model_copy(update={"cameras": cameras, "vocabulary": {}})


def _posed(message: Any) -> tuple[Pose, Float64Array | None]:
    return msg_to_pose(message, "map"), msg_to_covariance(message)


_PARTS = {name: PARTS[name] for name in ("camera", "depth_camera", "photo")} | {
    _POSE: ((POSE, _posed), (POSED_POSE, _posed))
}
