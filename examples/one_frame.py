"""One frame from photo to fuel map in plain calls: what the node graph does with each image, without the graph.

    .venv/bin/python examples/one_frame.py

Takes the first frame of one tower of the shipped recording (`bags/demo`) through the paper's chain: pose, tracing
(Algorithm 1), labels, depth fusion (TopoDepth), votes, fuel map. `tests/replay/test_one_frame_example.py` holds every
array equal to what the nodes make of that frame; docs/how/one_frame.md explains the steps.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ltm_core.base.resources import config_path, project_path
from ltm_core.base.types import Float64Array
from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.depth.topodepth import FusedDepth, fuse
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.vote_columns import fitting
from ltm_core.fuel.votes import CellVotes, VoteCaster
from ltm_core.geometry.range_image import DepthImage, RangeImage
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import UnlikelyLabels
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.site.networks import site_segmenter
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.segmenter import Segmentation
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import compressed_to_rgb
from ltm_msgs_py.pointcloud import msg_to_votes, votes_to_msg
from ltm_msgs_py.pose import msg_to_pose, pose_to_msg
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of


class OneFrame(NamedTuple):
    """What each step makes of a frame."""

    frame: PosedImage
    traced: RangeImage
    segmentation: Segmentation
    fused: FusedDepth
    votes: CellVotes
    layers: FuelLayers


def first_frame(recording: Path, site: Site, camera_name: str) -> tuple[PosedImage, Float64Array]:
    """A camera's first image with its calibration and pose, and the pose's covariance (6, 6)."""
    reader = BagReader(recording)
    image, info, pose = (
        reader.decode(next(reader.messages([f"/{site.name}/{camera_name}/{topic}"])))
        for topic in ("image_raw/compressed", "camera_info", "pose")
    )
    # The node `capture` reads the pose and sends it on; a rotation that goes through a quaternion may lose a last bit.
    where = msg_to_pose(pose_to_msg(msg_to_pose(pose, "map"), stamp_of(pose)))
    frame = PosedImage(compressed_to_rgb(image), msg_to_camera(info), where, stamp_of(image), camera_name)
    return frame, np.asarray(pose.pose.covariance, np.float64).reshape(6, 6)


def one_frame(recording: Path, site_file: Path, camera_name: str) -> OneFrame:
    """The whole chain for the first frame of a camera."""
    site = load_site(site_file)
    dem = site.open_dem()
    labels = LabelSet.load(config_path(site.labels))
    frame, covariance = first_frame(recording, site, camera_name)

    # Algorithm 1: where does the ray of each pixel meet the terrain?
    tracer = TerrainTracer(dem, site.curvature, site.refraction, site.possible_ground)
    traced = tracer.trace(frame.camera, frame.pose)
    depth = DepthImage(traced.depth(), frame.camera, frame.pose)

    direction = np.sqrt(np.radians(0.03) ** 2 + covariance.diagonal()[3:].max())  # of the calibration, and of the pose
    if not covariance.any():  # the pose came without one
        covariance = site.assumed_pose_error.covariance()

    # What grows there: a class for each pixel, and how sure the network is of it; sky is unlikely on traced ground.
    segmenter = site_segmenter(site, camera_name)
    segmentation = segmenter.segment(frame.image, UnlikelyLabels(tracer).of(frame.camera, frame.pose, covariance))

    # TopoDepth: a network's depth has no scale of its own; terrain that can be trusted gives it one.
    depth_network = DepthNetwork.open(site.depth_model)
    network = depth_network.predict(frame.image, frame.camera)
    settings = FusionSettings(float(direction))
    constants = depth_network.fusion  # fitted with this network
    classes = ClassPriors.of(labels, constants)
    fused = fuse(depth, network, frame.image, segmentation.labels, classes, settings, config=constants)

    # Votes take the traced depth: the cell that counts is the one on whose ground the plant stands.
    fuel_grid = site.fuel_geometry(dem)
    caster = VoteCaster(fuel_grid, dem, labels.votes_table[: len(labels)], site.fuel.max_range, site.bend)
    seen = (segmentation.labels, frame.stamp_ns, camera_name, segmentation.confidence)
    cast = caster.cast(depth.along, frame.camera, frame.pose, *seen, covariance)
    # They travel as a message of at most 64 kB, in decimetres and degrees: the map counts what arrives.
    votes = msg_to_votes(votes_to_msg(fitting(cast), labels.names), fuel_grid, labels.names, camera_name)

    # Evidence over the prior map. A single frame is kept but changes no cell: that takes a second look.
    fuel_map = site_evidence_map(site, fuel_grid, labels)
    fuel_map.add(votes)
    return OneFrame(frame, traced, segmentation, fused, votes, fuel_map.layers())


def report(made: OneFrame) -> None:
    """Print what was made."""
    depth, fused, votes, layers = made.traced.depth(), made.fused, made.votes, made.layers
    ground = np.isfinite(depth) & np.isfinite(fused.depth)
    moved = np.median(np.abs(fused.depth[ground] - depth[ground]))
    shares = [f"{name} {(made.segmentation.labels == i).mean():.1%}" for i, name in enumerate(LabelSet.load().names)]
    print(f"photo  {made.frame.image.shape[1]} x {made.frame.image.shape[0]} of {made.frame.camera_name}")
    print(f"depth  {np.isfinite(depth).mean():.1%} of the pixels show terrain, median {np.median(depth[ground]):.0f} m")
    print(f"labels {', '.join(shares)}")
    print(f"fused  verdict {fused.verdict}, {moved:.2f} m from the traced depth in the median")
    print(f"votes  {votes.counts.sum():,} pixels in {len(votes)} cells of {votes.geometry.resolution:g} m")
    print(f"map    {(layers.evidence > 0).sum()} cells with evidence, {layers.changed.sum()} changed")


if __name__ == "__main__":
    demo = project_path("bags/demo")
    report(one_frame(demo / "recording", demo / "site.yaml", "tower_north"))
