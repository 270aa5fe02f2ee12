"""Metrics say what /diagnostics say, number for number, and are what Prometheus reads."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
from scenes.tower_words import healths, status_of, watch_of

parser = pytest.importorskip("prometheus_client.parser", reason="the extra `tower` is not installed")

from ltm_ros.tower.metrics import exposition  # noqa: E402

DASHBOARD = Path(__file__).parents[4] / "packaging/grafana/ltm.json"
Samples = dict[tuple[str, tuple[tuple[str, str], ...]], float]


OUTBOX = {
    "outbox_frames": "ltm_outbox_frames",
    "outbox_bytes": "ltm_outbox_bytes",
    "outbox_age_s": "ltm_outbox_age_seconds",
    "link_up": "ltm_link_up",
}


def samples(text: str) -> Samples:
    found: Samples = {}
    for family in parser.text_string_to_metric_families(text):
        for sample in family.samples:
            key = (sample.name, tuple(sorted(sample.labels.items())))
            assert key not in found, f"{key} twice"
            found[key] = sample.value
    return found


def test_every_number_of_the_diagnostics_is_a_metric_with_that_value() -> None:
    made = healths()
    watch = watch_of(made)
    scraped = samples(exposition(status_of(watch)).decode())
    numbers = 0
    for name, report in watch.reports.items():
        camera = name.split("/")[2] if name.count("/") > 2 else ""
        labels = {"node": name, "camera": camera}

        def value(metric: str, labels: dict[str, str] = labels, **more: str) -> float:
            return scraped[metric, tuple(sorted({**labels, **more}.items()))]

        for key, text in report.values.items():
            try:
                number = float(text)
            except ValueError:
                continue
            if not math.isfinite(number) or key in ("dropped", "newest_stamp"):
                continue
            numbers += 1
            kind, _, rest = key.partition(".")
            if kind in ("dropped", "noted"):
                label = {"dropped": "cause", "noted": "event"}[kind]
                assert value(f"ltm_{kind}_total", **{label: rest}) == number
            elif matched := re.fullmatch(r"(latency|work)_p(50|95)_ms", key):
                quantile = {"50": "0.5", "95": "0.95"}[matched[2]]
                assert value(f"ltm_{matched[1]}_seconds", quantile=quantile) == pytest.approx(number / 1000)
            elif key in ("frames_in", "frames_out", "received", "published"):
                assert value(f"ltm_{key}_total") == number
            elif key == "rate_hz":
                assert value("ltm_rate_hertz") == number
            elif key in OUTBOX:
                assert scraped[OUTBOX[key], ()] == number
            elif key == "cpu_s":
                assert value("ltm_cpu_seconds_total") == number
            else:
                assert value("ltm_node_value", name=key) == number
        dropped = [v for (n, ls), v in scraped.items() if n == "ltm_dropped_total" and ("node", name) in ls]
        assert sum(dropped) == int(report.values["dropped"]), "by cause, nothing twice and nothing left out"
    assert numbers > 60


def test_cameras_and_machine() -> None:
    scraped = samples(exposition(status_of(watch_of(healths()))).decode())
    assert scraped["ltm_frame_age_seconds", (("camera", "north"),)] == 4.5
    assert scraped["ltm_frame_age_seconds", (("camera", "east"),)] == 700.25
    assert scraped["ltm_frames_finished_total", (("camera", "east"),)] == 16
    assert scraped["ltm_pose_verdicts_total", (("camera", "north"), ("verdict", "pose_suspected"))] == 1
    assert scraped["ltm_clock_synchronised", ()] == 0
    assert scraped["ltm_disk_free_bytes", (("folder", "/state"),)] == 2e9
    assert ("ltm_disk_free_bytes", (("folder", "/gone"),)) not in scraped
    assert scraped["ltm_process_memory_bytes", (("process", "cameras"),)] == 4e8
    assert scraped["ltm_build_info", (("ltm", "0.1.0"), ("ros_rclpy", "7.1.6"), ("site", "ridge"))] == 1
    assert (scraped["ltm_alive", ()], scraped["ltm_ready", ()]) == (1, 0)


def test_names_that_somebody_made_to_harm_break_no_line() -> None:
    made = healths()
    made["/ridge/fuel_map"].drop('a"} 1\nltm_alive 0\n{b="', "junk", 4)
    scraped = samples(exposition(status_of(watch_of(made))).decode())
    assert scraped["ltm_alive", ()] == 1
    causes = [dict(labels).get("cause") for (name, labels) in scraped if name == "ltm_dropped_total"]
    assert 'a"} 1\nltm_alive 0\n{b="' in causes


def test_the_dashboard_asks_for_metrics_that_there_are() -> None:
    names = {name for name, _ in samples(exposition(status_of(watch_of(healths()))).decode())}
    dashboard = json.loads(DASHBOARD.read_text())
    expressions = [t["expr"] for panel in dashboard["panels"] for t in panel.get("targets", ())]
    asked = {name for expression in expressions for name in re.findall(r"ltm_[a-z_]+", expression)}
    assert len(asked) > 10
    assert asked <= names | {"ltm_clock_error_seconds"}
