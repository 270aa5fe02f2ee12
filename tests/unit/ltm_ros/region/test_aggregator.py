import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from scenes.fuel_frames import BEGIN_NS, LABELS, message, votes
from scenes.region_scene import CAMERA, REGION, RegionScene, same_map, stamp_of, write_region_scene
from sensor_msgs.msg import PointCloud2

from ltm_core.base.errors import ConfigError, MessageError
from ltm_core.fuel.class_map import snapped_grid
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.uplink.envelope import (
    LARGEST,
    MOST_OUTCOMES,
    AckHeader,
    Outcome,
    VotesGrid,
    header_of,
    outcomes_of,
)
from ltm_msgs_py.pointcloud import msg_to_votes, votes_to_msg
from ltm_ros.region.aggregator import Aggregator
from ltm_ros.region.certs import TrialAuthority
from ltm_ros.region.identity import Identity
from ltm_ros.runtime.health import Health


class Region:
    def __init__(self, scene: RegionScene) -> None:
        self.scene, self.health = scene, Health()
        self.aggregator = Aggregator(scene.config, self.health, lambda: BEGIN_NS + 10**13)

    def send(self, tower: str, number: int, **changes: object) -> None:
        self.aggregator.take(tower, self.scene.sealed(tower, number, **changes))

    def answers(self) -> dict[str, list[Outcome]]:
        """What each tower is told, after the signatures have been checked."""
        told: dict[str, list[Outcome]] = {}
        for tower, sealed in self.aggregator.settle().items():
            for content in sealed:
                envelope = self.scene.identity(tower).opened(content, "aggregator")
                header = header_of(AckHeader, envelope)
                assert (header.region, header.tower) == (REGION, tower)
                told.setdefault(tower, []).extend(outcomes_of(envelope))
        return told

    @property
    def frames(self) -> int:
        return self.aggregator.persistence.saved_frames


def done(number: int) -> Outcome:
    return Outcome(camera=CAMERA, stamp_ns=stamp_of(number), done=True)


@pytest.fixture
def scene(tmp_path: Path) -> RegionScene:
    return write_region_scene(tmp_path)


@contextmanager
def living(scene: RegionScene) -> Iterator[Region]:
    region = Region(scene)
    yield region
    region.aggregator.close()


def test_a_frame_is_answered_for_once_it_is_stored_and_counted_once(scene: RegionScene) -> None:
    with living(scene) as region:
        region.send("alta", 1)
        region.send("alta", 1)
        region.send("bear", 1)
        assert (region.frames, region.health.summary()["noted.duplicate"]) == (0, "1")
        assert region.answers() == {"alta": [done(1)], "bear": [done(1)]}
        region.send("alta", 1)
        assert region.answers() == {"alta": [done(1)]}
        assert (region.frames, region.health.dropped) == (2, {})
    with living(scene) as region:
        region.send("bear", 1)
        region.send("bear", 2)
        assert region.answers() == {"bear": [done(1), done(2)]}
        assert region.aggregator.persistence.store is not None
        assert region.aggregator.persistence.store.sources() == {"alta_mast": 1, "bear_mast": 2}


def altered(content: bytes, place: int) -> bytes:
    changed = bytearray(content)
    changed[place] ^= 1
    return bytes(changed)


def test_what_cannot_be_believed_is_counted_and_not_answered(scene: RegionScene, tmp_path: Path) -> None:
    TrialAuthority(tmp_path / "others", days=2).make(REGION, ["alta"], ["localhost"], "127.0.0.1", 8883)
    broker = scene.broker("alta")
    strange = {name: tmp_path / "others" / getattr(broker, name).name for name in ("ca", "certificate", "key")}
    stranger = Identity(broker.model_copy(update=strange), "alta")
    good = scene.sealed("alta", 1)
    header = scene.header("alta", 1).model_dump_json().encode()
    cases = {
        "is signed by 'bear'": scene.identity("bear").sealed(header, scene.votes(1)),
        "are from bear": scene.identity("alta").sealed(scene.header("bear", 1).model_dump_json().encode(), b"x"),
        "not from an authority": stranger.sealed(header, scene.votes(1)),
        "modified": altered(good, good.index(b"stamp_ns") + 15),
        "was modified after": altered(good, len(good) - 300),
        "not an envelope": b"GET / HTTP/1.1" + bytes(200),
        "alta in another": scene.sealed("alta", 1, region="another"),
        "this has": bytes(LARGEST + 1),
        "invalid ": scene.identity("alta").sealed(b"{}", scene.votes(1)),
    }
    with living(scene) as region:
        for number, (words, content) in enumerate(cases.items(), start=1):
            region.aggregator.take("alta", content)
            assert words in region.health.last_error
            assert region.health.dropped == {"message": number}
        region.aggregator.take("crow", good)
        assert "not a tower of kern" in region.health.last_error
        assert region.answers() == {}
        assert region.frames == 0


def test_what_cannot_be_taken_is_answered_in_words(scene: RegionScene) -> None:
    votes, alta = scene.votes(1), scene.identity("alta")
    whole = scene.header("alta", 1)
    newer = json.dumps(whole.model_dump() | {"version": 2, "unheard_of": 1})
    coarse = whole.grid.model_copy(update={"resolution": 10.0})
    unknown = whole.grid.model_copy(update={"crs": "EPSG:99999"})
    late = stamp_of(20_000)
    cases = {
        "votes of version 2, but kern reads 1": (newer, votes),
        "alta_roof is not a camera of kern_map": (whole.model_copy(update={"camera": "roof"}), votes),
        "the header states stamp": (whole.model_copy(update={"stamp_ns": stamp_of(2)}), votes),
        "fuel cells are 10 m wide": (whole.model_copy(update={"grid": coarse}), votes),
        "unknown CRS": (whole.model_copy(update={"grid": unknown}), votes),
        "ahead of this node's clock": (
            whole.model_copy(update={"stamp_ns": late}),
            bytes(serialize_message(message(1, scene.geometry, late))),
        ),
        "60 bytes do not decode as votes": (whole, votes[:60]),
        "64000": (whole, bytes(64_001)),
    }
    with living(scene) as region:
        for words, (header, body) in cases.items():
            text = header if isinstance(header, str) else header.model_dump_json()
            region.aggregator.take("alta", alta.sealed(text.encode(), body))
            ((outcome,),) = region.answers().values()
            assert not outcome.done
            assert words in outcome.why
        assert region.frames == 0


def test_towers_of_another_origin_extent_and_crs_count_on_one_map(scene: RegionScene) -> None:
    """alta's site begins 4 cells further north-west and its map frame elsewhere; bear's is in the next UTM zone."""
    here = scene.site.in_crs(scene.geometry)
    wider = GridGeometry(here.x_min - 120, here.y_max + 120, 30.0, here.width + 9, here.height + 7, str(here.crs))
    zone_10 = snapped_grid(here, "EPSG:26910")
    grids = {"alta": VotesGrid.of(wider, (470_000.0, 4_140_000.0)), "bear": VotesGrid.of(zone_10, (900_000.0, 4e6))}
    seen = votes(1, scene.geometry, stamp_of(1))
    sent = {
        "alta": replace(seen, geometry=grids["alta"].in_map, rows=seen.rows + 4, cols=seen.cols + 4),
        "bear": votes(2, grids["bear"].in_map, stamp_of(2)),
    }
    with living(scene) as region:
        before = 0
        for number, (tower, cast) in enumerate(sent.items(), start=1):
            header = scene.header(tower, number, grid=grids[tower]).model_dump_json().encode()
            region.aggregator.take(tower, scene.identity(tower).sealed(header, _cdr(votes_to_msg(cast, LABELS.names))))
            assert region.answers() == {tower: [done(number)]}
            evidence = region.aggregator.persistence.map
            counted = int(evidence.layers().seen_by.sum()) - before
            before += counted
            if tower == "alta":
                expected = site_evidence_map(scene.site, scene.geometry, LABELS)
                direct = _cdr(votes_to_msg(seen, LABELS.names))
                expected.add(
                    msg_to_votes(deserialize_message(direct, PointCloud2), scene.geometry, LABELS.names, "alta_mast")
                )
                assert same_map(evidence, expected)
            else:
                # Cells of the other zone are turned by 2.4 degrees: each of ours takes the one that its centre is in.
                assert 0.9 < counted / len(cast) < 1.1
        assert region.health.dropped == {}


def test_a_certificate_that_has_run_out_is_not_believed(scene: RegionScene, tmp_path: Path) -> None:
    for name in ("alta.crt", "alta.key"):
        (scene.certs / name).unlink()
    TrialAuthority(scene.certs, days=0).make(REGION, ["alta"], [], "127.0.0.1", 8883)
    old = scene.identity("alta").sealed(b"{}")
    with pytest.raises(MessageError, match="renew it, or set the clock"):
        scene.identity("bear").opened(old, "alta")


def test_a_tower_that_means_harm_does_not_end_the_map(scene: RegionScene) -> None:
    """As many frames as an answer holds, each refused for a name of letters that JSON writes six times as long."""
    alta, evil = scene.identity("alta"), "\x1b" * 290
    with living(scene) as region:
        for number in range(MOST_OUTCOMES):
            header = json.dumps(scene.header("alta", number).model_dump() | {evil: 1}).encode()
            region.aggregator.take("alta", alta.sealed(header, scene.votes(number)))
        (outcomes,) = region.answers().values()
        assert {(outcome.done, outcome.why.isprintable()) for outcome in outcomes} == {(False, True)}
        assert len(outcomes) == MOST_OUTCOMES
        cloud = message(1, scene.geometry, stamp_of(1))
        cloud.fields[3].name = evil
        region.aggregator.take("alta", alta.sealed(scene.header("alta", 1).model_dump_json().encode(), _cdr(cloud)))
        assert "have the fields ???" in region.health.last_error
        cloud.width, cloud.row_step, cloud.data, cloud.point_step = 0, 0, [], 2**32 - 1
        region.aggregator.take("alta", alta.sealed(scene.header("alta", 1).model_dump_json().encode(), _cdr(cloud)))
        assert "point_step 4294967295" in region.health.last_error
        for number in range(20):
            region.aggregator.take(f"nobody{number}", b"")
        assert region.health.summary()["received"] == str(MOST_OUTCOMES + 2)
        region.send("alta", 1)
        assert region.answers()["alta"][-1] == done(1)


def _cdr(cloud: object) -> bytes:
    return bytes(serialize_message(cloud))


def test_an_identity_says_what_is_wrong_with_its_files(scene: RegionScene) -> None:
    broker = scene.broker("alta")
    wrong = {
        "not to 'bear'": (broker, "bear"),
        "does not belong to": (broker.model_copy(update={"key": scene.certs / "bear.key"}), "alta"),
        "no certificate in PEM": (broker.model_copy(update={"certificate": scene.certs / "acl"}), "alta"),
        "No such file": (broker.model_copy(update={"key": scene.certs / "none.key"}), "alta"),
    }
    for words, (config, name) in wrong.items():
        with pytest.raises(ConfigError, match=words):
            Identity(config, name)
