from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from ltm_core.base.types import UInt8Array
from ltm_core.fuel.label_errors import known_errors
from ltm_core.scoring.labels import SegmentationScore
from ltm_core.vision.labels import Label
from ltm_core.vision.manifest import DEFAULT_MODEL, MODEL_PATH_VARIABLE, NetworkManifest
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.metrics.skyline import SkylineTally, skyline
from ltm_lab.resources import lab_config


def _photo(path: Path, size: tuple[int, int]) -> UInt8Array:
    return np.ascontiguousarray(cv2.resize(cv2.imread(str(path)), size, interpolation=cv2.INTER_AREA)[..., ::-1])


def test_the_files_are_small_and_say_how_they_err() -> None:
    manifest = NetworkManifest.find(DEFAULT_MODEL)
    files = {m.model_file() for m in (manifest, NetworkManifest.find(f"{DEFAULT_MODEL}_depth"))}
    assert sum(file.stat().st_size for file in files) < 16e6
    right = known_errors(DEFAULT_MODEL).shares.diagonal()
    assert all(right[k - 1] > 0.3 for k in (Label.GRASS, Label.SHRUB, Label.TREE, Label.BARE))


def test_the_sky_of_held_out_photos_is_that_of_the_sky_network(
    shared_data: Path, shared_models: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(MODEL_PATH_VARIABLE, str(shared_models))
    teacher, ours = Segmenter.open("skyseg_u2netp"), Segmenter.open()
    names = yaml.safe_load(lab_config("training/mountain_photos.yaml").read_text())["held_out"]["photos_test"][::5]
    score, tally = SegmentationScore.empty(2), SkylineTally()
    for name in names:
        photo = _photo(shared_data / "mountain_photos" / "images" / f"{name}.jpg", (512, 341))
        true, found = teacher.segment(photo).labels == Label.SKY, ours.segment(photo).labels == Label.SKY
        score = score.plus(true.astype(np.uint8), found.astype(np.uint8))
        tally.add(skyline(found), skyline(true))
    assert score.iou[1] > 0.95
    assert tally.score().median <= 4.0
