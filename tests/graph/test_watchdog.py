"""Nodes that hang are killed and come back, and their camera delivers again; the others notice nothing."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from bystander import Bystander
from handler_for_tests import BLOCK, HEARD, SAID, SPIN
from scenes.small_site import NAME, SmallSite
from scenes.waiting import wait_for
from std_msgs.msg import Header

from ltm_core.site.sections import WatchdogConfig
from ltm_ros.launching.graph import Graph, NodeSpec
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy

pytestmark = pytest.mark.graph

HERE = Path(__file__).parent
QUICK = RestartPolicy(initial_s=0.1, maximum_s=0.4)
# A busy machine may keep a node that is well from its turn for long.
IMPATIENT = WatchdogConfig(silent=8.0, stuck=8.0, slow=300.0)


def test_a_worker_that_stands_is_noticed_though_its_node_answers(
    small_site: SmallSite, ros_domain: int, tmp_path: Path
) -> None:
    parameters = {"site": str(small_site.path)}
    nodes = [NodeSpec("echo", f"/{NAME}/{kind}", "handler_for_tests", parameters) for kind in (BLOCK, SPIN)]
    lines: list[str] = []
    runner = Runner(
        Graph(NAME, tuple(nodes), IMPATIENT),
        domain_id=ros_domain,
        console=lines.append,
        policy=QUICK,
        environment={"PYTHONPATH": str(HERE)},
    )
    with runner, Bystander() as bystander:
        runner.wait_until_ready(120.0)
        for node in nodes:
            bystander.listen(f"{node.namespace}/{SAID.name}", SAID.type, latched=True)
            bystander.open(f"{node.namespace}/{HEARD.name}", HEARD.type)
        bystander.wait_for_wiring(2)
        for kind, node in zip((BLOCK, SPIN), nodes, strict=True):
            bystander.send(f"{node.namespace}/{HEARD.name}", Header(frame_id=kind))
        for node in nodes:
            process = runner.processes[node.label]
            wait_for(lambda p=process: p.starts == 2 and p.running, "the node again", lambda: lines)  # type: ignore[misc]
        bystander.forget()
        bystander.wait_for_wiring(2)
        for node in nodes:
            heard, said = f"{node.namespace}/{HEARD.name}", bystander.heard[f"{node.namespace}/{SAID.name}"]
            ask = partial(bystander.send, heard, Header(frame_id="well"))
            bystander.send_until(ask, partial(bool, said), "its answer")
            assert {message.frame_id for message in said} == {"well"}
            process = runner.processes[node.label]
            assert process.hangs == 1
            told = [line for line in lines if line.startswith(f"[{node.label}] -- hung: ")]
            assert len(told) == 1
            assert "echo worker: Header has not finished in " in told[0]
    # And where it stood.
    text = "\n".join(lines)
    assert text.count('handler_for_tests.py", line') >= 2
    assert "on_message" in text
