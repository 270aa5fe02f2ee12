"""Compares simulated with real pictures by SSIM, LPIPS, FID and KID, each with its conditions and an interval."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_core.storage.image_io import read_rgb
from ltm_lab.evaluation.sim2real.distribution import (
    FEATURES,
    Estimate,
    frechet_distance,
    kernel_distance,
    mean_with_interval,
    with_interval,
)
from ltm_lab.evaluation.sim2real.perceptual_io import INCEPTION_SIZE, Inception, Lpips

PAPER = {"SSIM": 0.3614, "LPIPS": 0.4437, "FID": 354.3967}
"""Table "Sim-to-real evaluation" of the paper: pairs not aligned, N, weights and pairing not stated."""

_SUFFIXES = (".jpg", ".jpeg", ".png")
_NOT_PICTURES = ("_labels", "_mask", "_depth")
"""Ends of names (before the suffix) that simulator and graph give to rasters that are no pictures."""

Pair = tuple[Path, Path]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Comparison:
    """One metric. `sample`: what N counts, such as `200 pairs`. `floor`: the same between real pictures alone,
    where there are two or more."""

    name: str
    estimate: Estimate
    floor: Estimate | None
    sample: str
    weights: str
    better: str
    paper: float | None


@dataclass(frozen=True)
class Pairing:
    """Which pictures are compared with which, and by what rule."""

    pairs: tuple[Pair, ...]
    rule: str


def pair_up(real: Sequence[Path], simulated: Sequence[Path], count: int, seed: int) -> Pairing:
    """Pairs for SSIM and LPIPS: those of equal file names where there are any, else random ones, seeded.

    Random pairs are drawn without repeating a pair. Raises ImageError where a list is empty."""
    if not real or not simulated:
        raise ImageError(f"{len(real)} real and {len(simulated)} simulated pictures: both are needed")
    named = {path.stem: path for path in simulated}
    same = tuple((path, named[path.stem]) for path in real if path.stem in named)
    if same:
        return Pairing(same, "pictures of equal names")
    return Pairing(_drawn(real, simulated, count, seed), f"random pairs (pictures are not aligned), seed {seed}")


def compare(
    real: Sequence[Path],
    simulated: Sequence[Path],
    pairs: int = 300,
    side: int = 256,
    seed: int = 0,
    progress: Progress = lambda what, done, total: None,
) -> tuple[list[Comparison], Pairing]:
    """The metrics over two lists of pictures, each picture's middle square.

    FID and KID need four of each kind; fewer have only SSIM and LPIPS. `side`: pixels of the square for SSIM and LPIPS;
    FID and KID take 299. Raises ModelError where weights are absent, ImageError on pictures that cannot be read."""
    pairing = pair_up(real, simulated, pairs, seed)
    among_real = [(a, b) for a, b in _drawn(real, real, pairs, seed + 1) if a != b]
    lpips = Lpips.open()
    of_pairs = _pairwise(pairing.pairs, lpips, side, lambda i, n: progress("pairs", i, n))
    of_real = _pairwise(among_real, lpips, side, lambda i, n: progress("pairs of real pictures", i, n))
    paired = f"{len(pairing.pairs)} pairs"
    found = [
        Comparison(
            name, mean_with_interval(of_pairs[i], seed), mean_with_interval(of_real[i], seed) if among_real else None,
            paired, weights, better, PAPER[name],
        )
        for i, (name, weights, better) in enumerate(
            (("SSIM", "none", "higher"), ("LPIPS", "AlexNet, v0.1 linear", "lower"))
        )
    ]  # fmt: skip
    if min(len(real), len(simulated)) < 4:
        return found, pairing
    network = Inception()
    features = [
        _features(network, paths, lambda i, n, what=what: progress(what, i, n))  # type: ignore[misc]
        for what, paths in (("features of real pictures", real), ("features of simulated pictures", simulated))
    ]
    halves = np.random.default_rng(seed).permutation(len(real))
    half = len(real) // 2
    real_halves = features[0][halves[:half]], features[0][halves[half:]]
    counted = f"{len(real)} real, {len(simulated)} simulated"
    for name, distance in (("FID", frechet_distance), ("KID", kernel_distance)):
        found.append(
            Comparison(
                name, with_interval(distance, features[0], features[1], seed),
                with_interval(distance, real_halves[0], real_halves[1], seed),
                counted, "InceptionV3 2015-12-05", "lower", PAPER.get(name),
            )
        )  # fmt: skip
    return found, pairing


def advice(real: int, simulated: int) -> str | None:
    """Return what FID and KID need, or why KID is to be preferred; None if neither is the case."""
    fewest = min(real, simulated)
    if fewest < 4:
        return f"FID and KID need 4 pictures of each kind; there are {real} real and {simulated} simulated ones."
    if fewest >= FEATURES:
        return None
    return (
        f"Prefer KID: with {fewest} pictures, fewer than the {FEATURES} features, FID's covariance is singular and FID "
        "grows as pictures get fewer, so it compares only with FIDs of the same N; KID has no such bias."
    )


def ssim(a: UInt8Array, b: UInt8Array) -> float:
    """Mean SSIM of two pictures (H, W, 3): Gaussian windows of sigma 1.5, each channel by itself.

    Wang et al. 2004, "Image quality assessment"; by scikit-image."""
    from skimage.metrics import structural_similarity

    return float(
        structural_similarity(
            a, b, channel_axis=2, data_range=255, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
    )


def pictures_below(folder: Path) -> list[Path]:
    """Return the JPEG and PNG pictures of a folder and its subfolders, by name. Raises ImageError if there are none."""
    found = sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in _SUFFIXES and not path.stem.endswith(_NOT_PICTURES) and path.is_file()
    )
    if not found:
        raise ImageError(f"{folder} holds no picture: JPEG and PNG files are read")
    return found


def middle_square(picture: UInt8Array, side: int) -> UInt8Array:
    """Return the middle square of a picture (H, W, 3) at `side` x `side` pixels, by area means if it shrinks."""
    height, width = picture.shape[:2]
    edge = min(height, width)
    top, left = (height - edge) // 2, (width - edge) // 2
    square = np.ascontiguousarray(picture[top : top + edge, left : left + edge])
    method = cv2.INTER_AREA if side < edge else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(square, (side, side), interpolation=method), np.uint8)


def _drawn(first: Sequence[Path], second: Sequence[Path], count: int, seed: int) -> tuple[Pair, ...]:
    total = len(first) * len(second)
    chosen = np.random.default_rng(seed).choice(total, min(count, total), replace=False)
    return tuple((first[int(i) // len(second)], second[int(i) % len(second)]) for i in chosen)


def _pairwise(pairs: Sequence[Pair], lpips: Lpips, side: int, progress: Callable[[int, int], None]) -> Float64Array:
    """(2, N): SSIM and LPIPS of each pair."""
    values = np.empty((2, len(pairs)))
    for i, (a, b) in enumerate(pairs):
        first, second = (middle_square(read_rgb(path), side) for path in (a, b))
        values[:, i] = ssim(first, second), lpips.distance(first, second)
        progress(i + 1, len(pairs))
    return values


def _features(
    network: Inception, paths: Sequence[Path], progress: Callable[[int, int], None], batch: int = 8
) -> Float32Array:
    """(N, 2048), read and run a batch at a time."""
    rows = []
    for start in range(0, len(paths), batch):
        part = paths[start : start + batch]
        rows.append(network.features(np.stack([middle_square(read_rgb(path), INCEPTION_SIZE) for path in part])))
        progress(min(start + batch, len(paths)), len(paths))
    return np.concatenate(rows)
