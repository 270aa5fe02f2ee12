from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ltm_core.fuel.label_drift import FIRST_WEEKS, LIMIT, WEEK_NS
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.vision.labels import LabelSet
from ltm_ros.fuel_map.self_measurement import DRIFT_FILE, DriftWatch
from ltm_ros.runtime.health import Health


def votes(week: int, shrub: int, tree: int) -> CellVotes:
    labels = LabelSet.load()
    counts = np.zeros((1, len(labels)), np.uint32)
    counts[0, [labels.names.index("shrub"), labels.names.index("tree")]] = shrub, tree
    cell = np.zeros(1, np.int32)
    return CellVotes(
        GridGeometry(0, 60, 30, 2, 2), cell, cell, counts, np.zeros(1, np.float32), week * WEEK_NS, "north"
    )


def test_the_node_reports_a_drift_and_again_after_a_restart(tmp_path: Path) -> None:
    shown: Any = SimpleNamespace(
        life_form=np.full((2, 2), 2, np.uint8),
        seen=np.ones((2, 2), np.bool_),
        changed=np.array([[False, True], [False, False]]),
    )
    health = Health()
    watch = DriftWatch(LabelSet.load(), tmp_path, health)
    for week in range(FIRST_WEEKS + 8):
        assert not (week < FIRST_WEEKS and health.troubled)
        watch.take(votes(week, *((850, 150) if week < FIRST_WEEKS + 3 else (400, 600))), "", shown)
    for told in (health, again := Health()):
        if told is again:
            DriftWatch(LabelSet.load(), tmp_path, again)
        assert told.summary()["label_agreement.north"] == "0.4000"
        assert float(told.summary()["label_drift_sigmas.north"]) < -LIMIT
        weeks = [float(share) for share in told.summary()["label_weeks.north"].split()]  # the chart of the status page
        assert weeks == [0.85] * (FIRST_WEEKS + 3) + [0.4] * 4
        assert told.troubled
        assert "north" in told.message


def test_a_damaged_file_starts_the_charts_again(tmp_path: Path) -> None:
    (tmp_path / DRIFT_FILE).write_text("{")
    health = Health()
    DriftWatch(LabelSet.load(), tmp_path, health).save()
    assert health.troubled
    DriftWatch(LabelSet.load(), tmp_path, healthy := Health())
    assert not healthy.troubled
