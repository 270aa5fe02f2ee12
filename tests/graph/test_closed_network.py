"""What can be seen of a running node from another host: nothing. The other host is a network namespace of the test's
own, joined by a cable of its own (veth) to the namespace that the node runs in; no real interface is touched."""

import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from leftovers import wait_gone
from scenes.fuel_frames import NAME, write_site
from scenes.waiting import wait_for

from ltm_ros.runtime.ros_environment import PROFILE_VARIABLES

pytestmark = pytest.mark.graph

ONLOOKER = Path(__file__).parent / "onlooker.py"
HERE, THERE = "10.213.7.1", "10.213.7.2"
LOOPBACK = "127.0.0.1"
# As a ROS process on another host has it, which shares no memory with the tower.
UDP_ONLY = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <transport_descriptors>
      <transport_descriptor><transport_id>udp</transport_id><type>UDPv4</type></transport_descriptor>
    </transport_descriptors>
    <participant profile_name="stranger" is_default_profile="true">
      <rtps>
        <useBuiltinTransports>false</useBuiltinTransports>
        <userTransports><transport_id>udp</transport_id></userTransports>
      </rtps>
    </participant>
  </profiles>
</dds>
"""


@dataclass(frozen=True)
class Host:
    """A network namespace, which lives as long as the process in it."""

    pid: int

    def command(self, *command: str) -> list[str]:
        return ["nsenter", f"--target={self.pid}", "--net", *command]

    def run(self, *command: str) -> str:
        done = subprocess.run(self.command(*command), capture_output=True, text=True, timeout=30)
        assert done.returncode == 0, f"{' '.join(command)}: {done.stderr}"
        return done.stdout


@contextmanager
def a_host() -> Iterator[Host]:
    holder = subprocess.Popen(["unshare", "--net", "sh", "-c", "echo up; exec cat"], stdin=-1, stdout=-1, text=True)
    try:
        if holder.stdout.readline() != "up\n":
            pytest.skip("this machine lets nobody make network namespaces")
        yield Host(holder.pid)
    finally:
        holder.kill()
        holder.communicate()


@pytest.fixture
def hosts() -> Iterator[tuple[Host, Host]]:
    """The tower's host and another, with a cable between them."""
    if os.geteuid() != 0:
        pytest.skip("only root makes network namespaces")
    for tool in ("ip", "unshare", "nsenter"):
        if shutil.which(tool) is None:
            pytest.skip(f"needs {tool}: apt-get install iproute2 util-linux")
    with a_host() as tower, a_host() as other:
        tower.run("ip", "link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", str(other.pid))
        for host, address in ((tower, HERE), (other, THERE)):
            host.run("ip", "address", "add", f"{address}/24", "dev", "cable")
            host.run("ip", "link", "set", "lo", "up")
            host.run("ip", "link", "set", "cable", "up")
        yield tower, other


class Onlooker:
    """A ROS process on a host, in the test's domain. A context manager."""

    def __init__(self, host: Host, name: str, **environment: str) -> None:
        self._process = subprocess.Popen(
            host.command(sys.executable, str(ONLOOKER), name),
            env=os.environ | environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self) -> "Onlooker":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def sees(self) -> dict[str, list[str]]:
        self._process.stdin.write("look\n")
        self._process.stdin.flush()
        seen: dict[str, list[str]] = json.loads(self._process.stdout.readline())
        return seen

    def wait_for_topic(self, topic: str) -> None:
        wait_for(lambda: topic in self.sees()["topics"], f"{topic} to be seen", self.sees)


@contextmanager
def fuel_map_on(host: Host, site: Path) -> Iterator[int]:
    """Process id of a running node, the one that has services."""
    module, arguments = "ltm_ros.nodes.fuel_map", ["-r", f"__ns:=/{NAME}", "-p", f"site:={site}"]
    node = subprocess.Popen(host.command(sys.executable, "-m", module, "--ros-args", *arguments))
    try:
        yield node.pid
        assert node.poll() is None, "the node has gone"
    finally:
        node.terminate()
        node.wait(30)


def sockets(pid: int) -> list[tuple[str, str, int, int]]:
    """Of a process: protocol, address, port, bytes that wait in it unread; of TCP only those that listen."""
    inodes = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        target = str(link.readlink())
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = []
    for protocol in ("udp", "tcp", "udp6", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{protocol}").read_text().splitlines()[1:]:
            _, local, _, state, queues, *_, inode = line.split()[:10]
            if inode not in inodes or (protocol.startswith("tcp") and state != "0A"):
                continue
            address, _, port = local.partition(":")
            numbers = bytes.fromhex(address)[::-1]
            name = socket.inet_ntoa(numbers) if len(numbers) == 4 else address
            found.append((protocol, name, int(port, 16), int(queues.partition(":")[2], 16)))
    return found


def test_another_host_sees_and_reaches_nothing(
    hosts: tuple[Host, Host], ros_domain: int, kernels: None, tmp_path: Path
) -> None:
    tower, other = hosts
    (profile := tmp_path / "udp_only.xml").write_text(UDP_ONLY)
    # What somebody does who knows the tower's address, its domain, and how to ask every participant of it.
    stranger = dict.fromkeys(PROFILE_VARIABLES, str(profile)) | {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "ROS_STATIC_PEERS": HERE,
    }
    site = write_site(tmp_path)
    with ExitStack() as stack:
        pid = stack.enter_context(fuel_map_on(tower, site))
        insider = stack.enter_context(Onlooker(tower, "insider"))
        insider.wait_for_topic(f"/{NAME}/fuel_map")
        # Another process of the tower, found in the same way and open as every node was before.
        door = Onlooker(tower, "door", **dict.fromkeys(PROFILE_VARIABLES, str(profile)))
        stack.enter_context(door).wait_for_topic("/door")
        outsiders = []
        for name in ("first", "second"):
            # Once the second has found the door, the first has asked everybody more than once.
            outsiders.append(stack.enter_context(Onlooker(other, name, **stranger)))
            outsiders[-1].wait_for_topic("/door")

        seen = insider.sees()
        assert f"/{NAME}/fuel_map/save" in seen["services"]
        assert f"/{NAME}/fuel_map" in seen["nodes"]
        strangers = ("/first", "/second", "/door")
        for outsider in outsiders:
            seen = outsider.sees()
            assert set(seen["topics"]) <= {*strangers, "/parameter_events"}
            assert set(seen["nodes"]) <= {*strangers}
            assert {service.rpartition("/")[0] for service in seen["services"]} <= {*strangers}

        # ROS opens sockets beside the profile's, to send from; they are on no known port, and nobody reads them.
        exposed = [found for found in sockets(pid) if found[1] != LOOPBACK]
        assert {protocol for protocol, *_ in exposed} <= {"udp"}
        ports = {port for _, _, port, _ in exposed}
        knock = "import socket, sys; s = socket.socket(type=socket.SOCK_DGRAM)\n"
        knock += f"for port in sys.argv[1:]: s.sendto(b'RTPS' + bytes(60), ('{HERE}', int(port)))"
        other.run(sys.executable, "-c", knock, *map(str, ports))
        read = wait_gone(lambda: [str(p) for _, a, p, unread in sockets(pid) if a != LOOPBACK and not unread])
        assert read == [], "ports that another host can reach and that somebody reads"
