import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
from scenes.depth_score import score_depth

from ltm_core.scoring.fuel import FuelScore
from ltm_core.scoring.labels import SegmentationScore
from ltm_core.vision.labels import LabelSet
from ltm_ros.demo.report import CameraPictures, ReportData, Table, write_report
from ltm_ros.runtime.health import node_rows

LABELS = LabelSet.load()
VOID = {"meta", "img", "input", "br"}


class Page(HTMLParser):
    """Checks nesting; keeps the text and what the page would fetch."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.rows: list[list[str]] = []
        self.tags: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == [], f"not closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")]
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th", "code", "span") and {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data.strip()


def full() -> ReportData:
    rng = np.random.default_rng(4)
    photo = np.full((90, 160, 3), (90, 120, 60), np.uint8)
    truth = rng.uniform(20, 3000, (90, 160)).astype(np.float32)
    labels = rng.integers(0, 4, (90, 160)).astype(np.uint8)
    confusion = np.zeros((7, 7), np.int64)
    confusion[1, 1], confusion[1, 2], confusion[3, 3] = 30, 10, 60
    pixels = SegmentationScore.empty(7).plus(labels, np.where(labels == 2, 255, labels).astype(np.uint8))
    return ReportData(
        title="Ridge <demo>",
        summary="Two cameras & twenty frames.",
        conditions=[("bag", "bags/ridge"), ("machine", "2 cores")],
        nodes=node_rows(
            {
                "/ridge/north/depth": {
                    "frames_in": "61",
                    "frames_out": "20",
                    "received": "183",
                    "dropped": "3",
                    "dropped.pose": "1",
                    "dropped.overload": "2",
                }
                | {"latency_p50_ms": "64.2", "latency_p95_ms": "89.9", "work_p50_ms": "40.0", "queue": "0"},
                "/ridge/fuel_map": {"frames_in": "40", "frames_out": "12345", "dropped": "0"},
            }
        ),
        cameras=[CameraPictures("north", photo, photo, photo, "frame 1")],
        fuel_map=np.full((60, 80, 3), 200, np.uint8),
        depth=score_depth([truth + 2.0], [truth])[-1],
        labels=pixels,
        fuel=FuelScore(5000, 100, 90, confusion),
        label_set=LABELS,
        tables=[Table("Control points", ["point", "error, m"], [["gcp 1", 3.25], ["gcp 2", float("nan")]], "By hand.")],
        recording="out/demo/demo.rrd",
        files=[("fuel_map.tif", "class of each cell")],
    )


def test_report_is_one_wellformed_file_without_outside_resources(tmp_path: Path) -> None:
    path = write_report(tmp_path / "deep" / "report.html", full())
    html = path.read_text(encoding="utf-8")
    page = Page(html)
    assert len(page.sources) == 5, "a legend, three pictures of a camera, a map"
    assert all(source.startswith("data:image/jpeg;base64,") for source in page.sources)
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert not re.search(r"https?://|url\(|@import", html)
    for source in page.sources:
        data = np.frombuffer(base64.b64decode(source.split(",")[1]), np.uint8)
        assert cv2.imdecode(data, cv2.IMREAD_COLOR) is not None


def test_text_is_escaped(tmp_path: Path) -> None:
    html = write_report(tmp_path / "report.html", full()).read_text(encoding="utf-8")
    assert "Ridge &lt;demo&gt;" in html
    assert "cameras &amp; twenty" in html
    assert "<demo>" not in html
