import numpy as np
import pytest

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.tracing import TerrainTracer
from ltm_lab.bench.mountains import ridged_terrain
from ltm_lab.bench.peers import PEERS, PeerKind, TracedView
from ltm_lab.bench.tracing import bench_pose


@pytest.mark.parametrize("kind", PEERS, ids=lambda kind: kind.name)
def test_a_peer_sees_what_we_see(kind: PeerKind) -> None:
    if not kind.installed:
        pytest.skip(f"{kind.name} is not installed")
    dem = ridged_terrain(310)
    summit = bench_pose(dem)
    pose = Pose.from_angles(summit.position, summit.angles_deg[0], -35.0, 4.0)
    view = TracedView(Camera.from_fov(83, 61, 60.0), pose)
    theirs = np.asarray(kind.make(dem).prepare(view)(), np.float64).reshape(61, 83)
    traced = TerrainTracer(dem, curvature=False).trace(view.camera, view.pose)
    ours = traced.horizontal() if "march" in kind.name else traced.range
    hit = np.isfinite(theirs) & (theirs < 1e30) & (theirs > 0)
    assert (hit == np.isfinite(ours)).mean() > 0.95
    both = hit & np.isfinite(ours)
    assert both.mean() > 0.2
    assert np.median(np.abs(theirs[both] - ours[both])) < (1.5 if "march" in kind.name else 0.05)
