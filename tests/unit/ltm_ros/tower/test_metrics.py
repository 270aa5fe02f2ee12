import json
import math
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from scenes.tower_words import healths, status_of, watch_of

parser = pytest.importorskip("prometheus_client.parser", reason="the extra `tower` is not installed")

from ltm_ros.tower.metrics import exposition  # noqa: E402

RULES = Path(__file__).parents[4] / "config/alerts/ltm.rules.yml"
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
    for name, report in ((node.name, node) for node in status_of(watch).nodes):
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
    assert scraped["ltm_frames_finished_total", (("camera", "east"),)] == 28, "of fuel_votes"
    for camera, verdict in (("north", "ok"), ("east", "pose_suspected")):
        others = {
            dict(labels)["verdict"]: v
            for (n, labels), v in scraped.items()
            if n == "ltm_fusion_verdict" and ("camera", camera) in labels
        }
        assert others == {"ok": verdict == "ok", "pose_suspected": verdict != "ok"}, camera
    assert scraped["ltm_clock_synchronised", ()] == 0
    assert scraped["ltm_disk_free_bytes", (("folder", "/state"),)] == 2e9
    assert ("ltm_disk_free_bytes", (("folder", "/gone"),)) not in scraped
    assert scraped["ltm_build_info", (("ltm", "0.1.0"), ("ros_rclpy", "7.1.6"), ("site", "ridge"))] == 1
    assert (scraped["ltm_alive", ()], scraped["ltm_ready", ()]) == (1, 0)


def test_names_that_somebody_made_to_harm_break_no_line() -> None:
    made = healths()
    made["/ridge/fuel_map"].drop('a"} 1\nltm_alive 0\n{b="', "junk", 4)
    scraped = samples(exposition(status_of(watch_of(made))).decode())
    assert scraped["ltm_alive", ()] == 1
    causes = [dict(labels).get("cause") for (name, labels) in scraped if name == "ltm_dropped_total"]
    assert 'a"} 1\nltm_alive 0\n{b="' in causes


def scraped() -> str:
    made = healths()
    made["/ridge/north/topodepth"].gauge("verdict", "pose_suspected")
    return exposition(status_of(watch_of(made))).decode()


def test_alert_rules_use_metrics_and_labels_that_there_are() -> None:
    published = samples(scraped())
    labels: dict[str, set[str]] = {}
    for name, pairs in published:
        labels.setdefault(name, set()).update(f"{key}={value}" for key, value in pairs)
    rules = [rule for group in yaml.safe_load(RULES.read_text())["groups"] for rule in group["rules"]]
    assert len(rules) > 5
    for rule in rules:
        asked = re.findall(r"(\w+)(?:{([^}]*)})? *(?:[=<>/]|unless|and|$)", rule["expr"])
        named = [(name, selector) for name, selector in asked if name.startswith("ltm_")]
        assert named or rule["alert"] == "LtmTowerUnreachable"
        for name, selector in named:
            assert name in labels, rule
            for key, values in re.findall(r'(\w+)=~?"([^"]*)"', selector):
                assert {f"{key}={value}" for value in values.split("|")} <= labels[name], rule


def test_prometheus_fires_each_rule_on_what_a_tower_publishes(tmp_path: Path) -> None:
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("needs promtool: apt install prometheus")
    series = []
    for (name, pairs), value in samples(scraped()).items():
        if math.isfinite(value):
            text = ",".join(f"{key}={json.dumps(said)}" for key, said in (*pairs, ("instance", "t"), ("job", "ltm")))
            series.append({"series": f"{name}{{{text}}}", "values": f"{value}x40"})
    series += [{"series": 'up{instance="t", job="ltm"}', "values": "0x40"}]
    series += [{"series": 'ltm_node_up{instance="t", node="/ridge/east/depth"}', "values": "0x40"}]
    names = {rule["alert"] for rule in yaml.safe_load(RULES.read_text())["groups"][0]["rules"]}
    expected = [{"labels": f'{{alertname="{name}"}}', "value": 1} for name in sorted(names - {"LtmFramesOld"})]
    firing = {"expr": 'group by (alertname) (ALERTS{alertstate="firing"})', "eval_time": "30m", "exp_samples": expected}
    tests = [{"interval": "1m", "input_series": series, "promql_expr_test": [firing]}]
    old = [{"series": 'ltm_frame_age_seconds{camera="north"}', "values": "1000x40"}]
    night = [{"series": 'ltm_camera_state{camera="north", state="night"}', "values": "0x5 1x40"}]
    for eval_time, count in (("3m", [{"labels": "{}", "value": 1}]), ("20m", [])):
        query = {"expr": 'count(ALERTS{alertstate="firing"})', "eval_time": eval_time, "exp_samples": count}
        tests.append({"interval": "1m", "input_series": old + night, "promql_expr_test": [query]})
    file = tmp_path / "rules_test.yml"
    file.write_text(yaml.safe_dump({"rule_files": [str(RULES)], "evaluation_interval": "1m", "tests": tests}))
    done = subprocess.run([promtool, "test", "rules", str(file)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
