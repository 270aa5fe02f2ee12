"""`ltm-lab bench segmentation`: a real node answers every photo."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import LtmError
from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_core.vision.usable import judge
from ltm_lab.bench.segmentation import drawn_landscape, run_segmentation
from ltm_lab.cli.bench.segmentation import segmentation

pytestmark = pytest.mark.graph


@pytest.mark.slow
def test_a_node_labels_as_many_photos_as_it_is_sent(
    ros_domain: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "new" / "rate.json"
    segmentation(width=320, height=192, threads="1", frames=6, repeats=1, domain=ros_domain, json_path=report)
    (row,) = json.loads(report.read_text())["rows"]
    assert (row["model"], row["node"]["frames"]) == (DEFAULT_MODEL, 6)
    assert all(row["node"][key] > 0 for key in ("hz", "cpu_ms", "latency_ms"))
    assert "labels of a 320 x 192 photo" in capsys.readouterr().out


def test_a_node_without_its_network_is_told_of(ros_domain: int, tmp_path: Path) -> None:
    with pytest.raises(LtmError, match="segmentation"):
        run_segmentation(str(tmp_path / "absent.yaml"), 1, drawn_landscape(64, 96), 5, ros_domain)


def test_what_a_node_would_not_label_is_not_timed() -> None:
    """Noise is no picture that can be used, so the network would not run; the bench's own picture can be."""
    noise = np.random.default_rng(0).integers(0, 256, (1080, 1920, 3), dtype=np.uint8)
    with pytest.raises(LtmError, match="would not label it"):
        run_segmentation("landscape_lite0", 1, noise, 5)
    for height, width in ((1080, 1920), (192, 320), (64, 96)):
        assert judge(drawn_landscape(height, width)).reason is None
