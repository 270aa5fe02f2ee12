from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest
from bystander import Bystander
from scenes.small_site import NAME, SmallSite
from scenes.waiting import wait_for

from ltm_ros.launching.graph import Graph, NodeSpec, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import DEPTH_IMAGE, IMAGE_RAW, camera_topic

pytestmark = pytest.mark.graph


def nodes_of(small: SmallSite, without: Iterable[str], missing: str = "nowhere.yaml") -> tuple[NodeSpec, ...]:
    """Captures and depths of both cameras; those of the cameras `without` are told a site that is not there."""
    whole = describe(small.site, small.path)
    nodes = [whole.node(f"{camera}/{kind}") for camera in ("tower", "mast") for kind in ("capture", "depth")]
    nowhere = str(small.folder / missing)
    return tuple(
        replace(node, parameters={**node.parameters, "site": nowhere})
        if node.name == "depth" and node.namespace.rpartition("/")[2] in without
        else node
        for node in nodes
    )


def test_a_camera_that_cannot_be_started_is_named_and_the_other_delivers_until_it_can(
    small_site: SmallSite, ros_domain: int, tmp_path: Path
) -> None:
    """What was missing appears while the graph runs: then the camera is there too, and no process was started anew."""
    lines: list[str] = []
    graph = Graph(NAME, nodes_of(small_site, ["tower"], "later.yaml"))
    depths = camera_topic(NAME, "mast", DEPTH_IMAGE)
    images = camera_topic(NAME, "mast", IMAGE_RAW)
    with Runner(graph, domain_id=ros_domain, console=lines.append) as runner, Bystander() as seen:
        seen.listen(depths, DEPTH_IMAGE.type)
        seen.open(images, IMAGE_RAW.type)
        photo = small_site.messages()[IMAGE_RAW]
        wait_for(lambda: f"/{NAME}/mast/depth" in seen.summaries, "the mast's nodes", lambda: lines)
        seen.wait_for_wiring(2)
        seen.send(images, photo)
        wait_for(lambda: seen.stamps(depths), "its depth", lambda: seen.summaries)
        (told,) = [line for line in lines if "cannot start" in line]
        assert f"/{NAME}/tower: cannot start" in told
        assert "later.yaml" in told
        assert not any(name.startswith(f"/{NAME}/tower/") for name in dict(seen.summaries))
        late = camera_topic(NAME, "tower", DEPTH_IMAGE)
        seen.listen(late, DEPTH_IMAGE.type)
        inputs = {camera_topic(NAME, "tower", topic): message for topic, message in small_site.messages().items()}
        del inputs[camera_topic(NAME, "tower", IMAGE_RAW)]
        shutil.copy(small_site.path, small_site.folder / "later.yaml")
        wait_for(lambda: f"/{NAME}/tower/depth" in seen.summaries, "the tower's nodes", lambda: lines)
        for name, message in inputs.items():
            seen.open(name, type(message))
        seen.wait_for_wiring(4)
        for name, message in inputs.items():
            seen.send(name, message)
        wait_for(lambda: seen.stamps(late), "the tower's depth", lambda: seen.summaries)
        assert any(f"/{NAME}/tower: started" in line for line in lines)
        assert runner.processes["cameras"].starts == 1
