"""Sets of pictures against each other; the whole with its real weights is a slow test."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from ltm_core.base.errors import ImageError
from ltm_lab.evaluation.sim2real.comparison import pictures_below, ssim


def picture(seed: int, height: int = 60, width: int = 90) -> np.ndarray:
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 255, (6, 9, 3)).astype(np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def folder(path: Path, seeds: range, prefix: str) -> Path:
    path.mkdir()
    for seed in seeds:
        cv2.imwrite(str(path / f"{prefix}{seed:03d}.png"), picture(seed))
    return path


def test_ssim_of_constant_pictures() -> None:
    # No structure: the luminance term alone, (2 a b + c) / (a^2 + b^2 + c) with c = (0.01 * 255)^2.
    a, b, c = 100.0, 140.0, (0.01 * 255) ** 2
    found = ssim(np.full((40, 50, 3), 100, np.uint8), np.full((40, 50, 3), 140, np.uint8))
    assert found == pytest.approx((2 * a * b + c) / (a * a + b * b + c), rel=1e-6)
    assert ssim(picture(1), picture(1)) == 1


def test_pictures_below(tmp_path: Path) -> None:
    real = folder(tmp_path / "real", range(3), "a")
    cv2.imwrite(str(real / "0000_labels.png"), np.zeros((4, 4), np.uint8))
    (real / "notes.txt").touch()
    assert [p.stem for p in pictures_below(real)] == ["a000", "a001", "a002"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(ImageError, match="no picture"):
        pictures_below(tmp_path / "empty")
