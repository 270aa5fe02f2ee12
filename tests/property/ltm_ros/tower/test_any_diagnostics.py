"""Whatever comes on /diagnostics in a node's name: the state can be told, in every form, and says no number twice."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes.tower_words import NODES, status_of

from ltm_ros.tower.tower_status import TowerWatch

parser = pytest.importorskip("prometheus_client.parser", reason="the extra `tower` is not installed")

from ltm_ros.tower.metrics import exposition  # noqa: E402

KEYS = st.one_of(
    st.sampled_from(["frames_in", "dropped", "dropped.shed", "noted.x", "noted.verdict.ok", "newest_stamp", "verdict"]),
    st.sampled_from(["latency_p50_ms", "work_p95_ms", "rate_hz", "cpu_s", "mount", "finished", "reason.shed"]),
    st.text(max_size=20),
    st.text(max_size=10).map(lambda text: f"dropped.{text}"),
)
VALUES = st.one_of(
    st.sampled_from(["nan", "inf", "-inf", "1e400", "", "0x10", "1_000", "-1", "٣"]),
    st.floats().map(str),
    st.integers().map(str),
    st.text(max_size=30),
)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(NODES), st.booleans(), st.text(max_size=30), st.dictionaries(KEYS, VALUES, max_size=12)
        ),
        max_size=5,
    )
)
def test_every_form_can_be_made(words: list[tuple[str, bool, str, dict[str, str]]]) -> None:
    watch = TowerWatch("ridge", NODES, 120.0)
    for name, troubled, message, values in words:
        watch.hear(name, troubled, message, values, 50.0)
    status = status_of(watch)
    json.dumps(status.as_dict(), allow_nan=False)
    assert status.ready <= status.alive
    seen = set()
    for family in parser.text_string_to_metric_families(exposition(status).decode()):
        for sample in family.samples:
            key = (sample.name, tuple(sorted(sample.labels.items())))
            assert key not in seen
            seen.add(key)
