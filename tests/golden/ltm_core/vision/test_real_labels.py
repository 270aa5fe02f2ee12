"""The default network, and the head that ships with it, on photographs that neither was taught by."""

from __future__ import annotations

from pathlib import Path

from ltm_core.evaluation.segmentation.ignored_classes import without_classes
from ltm_core.evaluation.segmentation.network_score import score_frames
from ltm_core.training.labelled_frames import read_frames
from ltm_core.vision.labels import Label
from ltm_core.vision.segmenter import Segmenter


def test_towers_without_any_teaching(shared_data: Path) -> None:
    counted = (Label.SKY, Label.SHRUB, Label.BARE, Label.BUILT)
    score = score_frames(Segmenter.open(), read_frames(shared_data / "hpwren_towers", 7), macro=counted)
    assert score.macro_f1 >= 0.62  # 0.69 by `ltm eval segmentation`
    assert score.labels.f1[Label.BUILT] > 0.25


def test_near_plants_by_the_head_for_them(shared_data: Path) -> None:
    frames = without_classes(read_frames(shared_data / "rellis_grid" / "train", 7), [Label.SHRUB])
    counted = (Label.SKY, Label.GRASS, Label.TREE, Label.BARE)
    score = score_frames(Segmenter.open(head="near"), frames, macro=counted)
    assert score.macro_f1 >= 0.70  # 0.74; without the head 0.60
    assert score.land_calibration.ece <= 0.08
    assert score.land_risk.risk(0.8) <= 0.8 * score.land_risk.risk()
