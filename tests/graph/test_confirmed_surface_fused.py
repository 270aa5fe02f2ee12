"""Fused depth follows the confirmed surface through a living chain, of which any process is killed meanwhile."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bystander import Bystander
from scenes.small_site import BEGIN_NS, NAME
from scenes.terrain_frames import HOUR, built_up, mast_pose, photo_of_depth, write_fusing_site
from scenes.waiting import wait_for

from ltm_core.pipeline.site_surface import exported_terrain
from ltm_core.tracing import TerrainTracer
from ltm_msgs_py.image import image_to_msg, msg_to_depth
from ltm_msgs_py.json_topics import msg_to_traced, msg_to_version
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.runtime.topics import DEPTH_INFO, FUSED_DEPTH, IMAGE_RAW, TERRAIN_SURFACE, camera_topic, site_topic

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

KINDS = ("capture", "depth", "segmentation", "fuel_votes", "topodepth")
SURFACE = site_topic(NAME, TERRAIN_SURFACE)
IMAGES, INFO, FUSED = (camera_topic(NAME, "mast", topic) for topic in (IMAGE_RAW, DEPTH_INFO, FUSED_DEPTH))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("layout", "killed"),
    [("site", "cameras"), *(("node", label) for label in ("terrain", "fuel_map", *(f"mast/{kind}" for kind in KINDS)))],
)
def test_any_process_may_be_killed_while_the_surface_changes(
    ros_domain: int, tmp_path: Path, layout: str, killed: str
) -> None:
    """What traces comes back to frames that are traced to a version which it has never seen, and goes on with that; the
    fuel map hears of them.
    """
    terrain = {"threshold": 2.0, "register_frames": False, "trace_confirmed": True}
    (tmp_path / "site").mkdir()
    small = write_fusing_site(tmp_path / "site", False, terrain=terrain, processes=layout)
    state = {name: {"folder": str(tmp_path / "kept")} for name in ("terrain", "fuel_map")}
    whole = describe(small.site, small.path, parameters=state)
    labels = ("terrain", "fuel_map", *(f"mast/{kind}" for kind in KINDS))
    runner = Runner(
        Graph(NAME, tuple(whole.node(label) for label in labels)),
        domain_id=ros_domain,
        log_folder=tmp_path / "log",
        console=lambda line: None,
        policy=RestartPolicy(initial_s=0.1, maximum_s=1.0),
    )
    camera, pose = small.site.camera("mast").calibration.camera(), mast_pose(small)
    photo = photo_of_depth(built_up(small), camera, pose)
    was, now = (TerrainTracer(dem).trace(camera, pose).depth() for dem in (small.dem, built_up(small)))
    block = np.isfinite(was) & np.isfinite(now)
    block[block] = np.abs(was[block] - now[block]) > 5.0
    with runner, Bystander() as bystander:
        runner.wait_until_ready(300.0)
        bystander.listen(SURFACE, TERRAIN_SURFACE.type, latched=True)
        bystander.listen(INFO, DEPTH_INFO.type)
        bystander.listen(FUSED, FUSED_DEPTH.type)
        bystander.open(IMAGES, IMAGE_RAW.type)
        bystander.wait_for_wiring(len(labels))

        def fused(stamp: int) -> bool:
            return any(stamp_of(message) == stamp for message in list(bystander.heard[FUSED]))

        def look(number: int) -> int:
            stamp = BEGIN_NS + number * 2 * HOUR
            bystander.send(IMAGES, image_to_msg(photo, "rgb8", stamp, "mast_optical"))
            return stamp

        def versions() -> list[str]:
            """That were told of, the one that counts last."""
            return [msg_to_version(message) for message in list(bystander.heard[SURFACE])]

        def version() -> str:
            return next(reversed(versions()), "")

        def exported() -> str:
            found = exported_terrain(small.site, tmp_path / "kept").version
            return "" if found is None else found.version

        number = 0
        while not version():
            stamp = look(number)
            wait_for(lambda at=stamp: fused(at), f"frame {number} fused", lambda: bystander.summaries)
            number += 1
            assert number < 8, "nothing was confirmed"
            terrain_frames = number
            wait_for(
                lambda n=terrain_frames: bystander.count(f"/{NAME}/terrain", "frames") >= n or bool(version()),
                f"{number} frames in the terrain",
                lambda: bystander.summaries,
            )
        process = runner.processes[killed]
        starts = process.starts
        # A frame is on its way as it dies.
        look(number)
        runner.kill(killed)
        wait_for(lambda: process.starts > starts and process.running, "the process again")
        bystander.forget()
        bystander.wait_for_wiring(len(labels))
        counts = version()
        stamp = BEGIN_NS + (number + 1) * 2 * HOUR
        bystander.send_until(lambda: look(number + 1), lambda: fused(stamp), "a frame fused after the kill")
        wait_for(
            lambda: bystander.count(f"/{NAME}/fuel_map", "frames") > 0, "labels in its map", lambda: bystander.summaries
        )
        traced = dict(msg_to_traced(message) for message in list(bystander.heard[INFO]))
        depths = {stamp_of(message): msg_to_depth(message) for message in list(bystander.heard[FUSED])}
        dropped = bystander.dropped(f"/{NAME}/mast/topodepth")
        wait_for(lambda: exported() == version(), "maps to export what counts", lambda: (exported(), versions()))
        told = versions()
    # Frames on their way may have changed what counts, as the end of the terrain's node may.
    assert traced[stamp] in told[told.index(counts) :]
    assert "" not in (traced[stamp], told[-1])
    assert traced[BEGIN_NS] == ""
    seen = block & np.isfinite(depths[stamp])
    assert seen.sum() > 20
    assert np.median(np.abs(depths[stamp][seen] - now[seen])) < 0.5 * np.median(np.abs(was[seen] - now[seen]))
    assert "store" not in dropped, dropped
