"""The default network, and the head that ships with it, on photographs that neither was taught by."""

from pathlib import Path

import numpy as np

from ltm_core.label_heads.labelled_frames import read_frames, without_classes
from ltm_core.storage.image_io import read_rgb
from ltm_core.vision.labels import Label
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.segmentation.network_score import score_frames


def test_towers_without_any_teaching(shared_data: Path) -> None:
    counted = (Label.SKY, Label.SHRUB, Label.BARE, Label.BUILT)
    score = score_frames(Segmenter.open(), read_frames(shared_data / "hpwren_towers", 7), macro=counted)
    assert score.macro_f1 >= 0.84  # 0.868 by `ltm-lab eval segmentation`
    assert score.labels.f1[Label.SHRUB] >= 0.87  # 0.884
    assert score.labels.f1[Label.TREE] >= 0.30  # 0.325
    assert score.labels.f1[Label.BUILT] > 0.65  # 0.742


def test_a_glacier_and_its_cliffs_are_no_plants(shared_data: Path) -> None:
    segmenter = Segmenter.open()
    for name in ("IMG_8902", "IMG_8937"):
        (path,) = (shared_data / "engabreen").rglob(f"{name}.jpg")
        labels = segmenter.segment(read_rgb(path)).labels
        plants = np.isin(labels, (Label.GRASS, Label.SHRUB, Label.TREE)).mean()
        assert plants < 0.035  # 0.024 and 0.029


def test_near_plants_by_the_head_for_them(shared_data: Path) -> None:
    frames = without_classes(read_frames(shared_data / "rellis_grid" / "train", 7), [Label.SHRUB])
    counted = (Label.SKY, Label.GRASS, Label.TREE, Label.BARE)
    score = score_frames(Segmenter.open(head="near"), frames, macro=counted)
    assert score.macro_f1 >= 0.70  # 0.74; without the head 0.67
    assert score.land_calibration.ece <= 0.08
    assert score.land_calibration.risk(0.8) <= 0.8 * score.land_calibration.risk()
