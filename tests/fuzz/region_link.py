"""What comes over the link between towers and their region's map: envelopes on either side, and a tower's outbox."""

import contextlib
import sqlite3
from pathlib import Path

from scenes.region_scene import REGION, RegionScene, stamp_of, write_region_scene

from fuzz.target import Target
from ltm_core.base.errors import MessageError
from ltm_core.uplink.envelope import AckHeader, Outcome, Outcomes, outcomes_of, unpacked
from ltm_core.uplink.outbox_io import Outbox, OutboxFrame
from ltm_ros.region.aggregator import Aggregator
from ltm_ros.runtime.health import Health

_MARK = b"\0body\0"
"""Between the header and the body of what is sealed after it was spoiled."""


def _envelopes(folder: Path) -> list[bytes]:
    scene = write_region_scene(folder)
    header = AckHeader(region=REGION, tower="alta").model_dump_json().encode()
    outcome = Outcome(camera="mast", stamp_ns=stamp_of(1), done=False, why="later")
    body = Outcomes(outcomes=[outcome]).model_dump_json().encode()
    return [scene.sealed("alta", 1), scene.identity("alta").sealed(header, body)]


def _open(folder: Path) -> None:
    content, scene = (folder / "envelope").read_bytes(), RegionScene(folder)
    envelope = unpacked(content)
    with contextlib.suppress(MessageError):
        outcomes_of(envelope)
    scene.identity("bear").opened(content, "alta")


def _votes(folder: Path) -> list[bytes]:
    scene = write_region_scene(folder)
    header = scene.header("alta", 1)
    other = header.model_copy(update={"grid": header.grid.model_copy(update={"crs": "EPSG:26910"})})
    return [one.model_dump_json().encode() + _MARK + scene.votes(1) for one in (header, other)]


def _count(folder: Path) -> None:
    """Sealed by a tower that means harm."""
    scene = RegionScene(folder)
    header, _, body = (folder / "votes").read_bytes().partition(_MARK)
    aggregator = Aggregator(scene.config, Health(), lambda: stamp_of(100))
    try:
        aggregator.take("alta", scene.identity("alta").sealed(header, body))
        aggregator.settle()
    finally:
        aggregator.close()


def _outboxes(folder: Path) -> list[bytes]:
    path = folder / "made.sqlite"
    path.unlink(missing_ok=True)
    with contextlib.closing(Outbox(path, 10**9, 1e9)) as outbox:
        outbox.put([OutboxFrame("mast", number, number % 3, "a network", bytes(900)) for number in range(40)])
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode = DELETE")
    return [path.read_bytes()]


def _read_outbox(folder: Path) -> None:
    path = folder / "outbox.sqlite"
    for ending in ("-wal", "-shm", "-journal"):
        path.with_name(path.name + ending).unlink(missing_ok=True)
    with contextlib.closing(Outbox(path, 10_000, 1e9)) as outbox:
        outbox.put([OutboxFrame("mast", 10**6, 0, "", b"x")])
        outbox.bound(2 * 10**18)
        found = [key for key, _ in outbox.waiting(20, 0.0)]
        for key in found:
            outbox.frame(key)
        outbox.postpone(found[:3], 9.0)
        outbox.acknowledge(found)
        outbox.oldest_ns()


REGION_LINK = (
    Target("envelope", "envelope", _envelopes, _open),
    Target("region_votes", "votes", _votes, _count),
    Target("outbox", "outbox.sqlite", _outboxes, _read_outbox),
)
