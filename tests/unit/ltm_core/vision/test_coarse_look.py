from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.networks import COLORS, changed, write_classifier, write_swapping_head

from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.vision.label_head import read_label_head
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.second_scale import with_coarse_look
from ltm_core.vision.segmenter import Segmenter

LOOK = {"width": 20, "height": 14, "share": 0.3}
SKY = (0,)


def probabilities(scores: Float32Array) -> Float32Array:
    odds = np.exp(scores - scores.max(axis=0))
    return np.asarray(odds / odds.sum(axis=0), np.float32)


def planes(values: list[float], size: tuple[int, int]) -> Float32Array:
    return np.broadcast_to(np.array(values, np.float32)[:, None, None], (len(values), *size)).copy()


def test_land_is_the_geometric_mean_and_sky_is_the_first_look_s() -> None:
    fine, coarse = planes([1.0, 2.0, 0.5, -1.0], (6, 10)), planes([3.0, -1.0, 2.5, 0.0], (3, 4))
    found = probabilities(with_coarse_look(fine, coarse, 0.25, SKY))
    p, q = probabilities(fine)[1:, 0, 0], probabilities(coarse)[1:, 0, 0]
    land = p**0.75 * q**0.25
    expected = np.array([probabilities(fine)[0, 0, 0], *(land / land.sum() * p.sum())])
    np.testing.assert_allclose(found, np.broadcast_to(expected[:, None, None], found.shape), rtol=1e-5)


def test_the_crest_keeps_its_classes_and_a_cloud_does_not() -> None:
    """160 columns: two rows below the sky are as they were, the next two half and half, then the mean as elsewhere."""
    fine, coarse = planes([-3.0, 2.0, 0.5], (20, 160)), planes([-3.0, -1.0, 2.5], (10, 80))
    fine[0, :8] = 9.0
    fine[0, 3:5, 40:60] = -3.0  # a cloud that is no sky
    fine[:, :, 100:] = planes([-3.0, 2.0, 0.5], (20, 60))  # no sky above at all
    moved = with_coarse_look(fine, coarse, 0.5, SKY) - fine
    odds = moved[1] - moved[2]  # of the first class of land
    full = 0.5 * ((-1.0 - 2.0) - (2.5 - 0.5))
    np.testing.assert_allclose(odds[[8, 9]][:, :100], 0.0, atol=1e-5)
    np.testing.assert_allclose(odds[10, :100], 0.5 * full, rtol=1e-5)
    np.testing.assert_allclose(odds[11:], full, rtol=1e-5)
    np.testing.assert_allclose(odds[3:5, 40:60], full, rtol=1e-5)
    np.testing.assert_allclose(odds[:, 100:], full, rtol=1e-5)


def photo() -> UInt8Array:
    """Sky above stripes of red and lime that a coarse look cannot tell apart, and one broad field of each."""
    image = np.empty((96, 144, 3), np.uint8)
    image[:40] = COLORS["blue"]
    image[40:, :60], image[40:, 60:90] = COLORS["red"], COLORS["lime"]
    image[40:, 90:] = [COLORS["red" if x // 4 % 2 else "lime"] for x in range(54)]
    return image


@pytest.mark.parametrize("headed", [False, True])
def test_a_network_looks_twice_where_its_manifest_says_so(tmp_path: Path, headed: bool) -> None:
    """And a head corrects what it sees both times."""
    folder = tmp_path / "small"
    folder.mkdir()
    size = {"width": LOOK["width"], "height": LOOK["height"]}
    paths = [write_classifier(to, any_size=True, gain=3.0, maps=True) for to in (tmp_path, folder)]
    once, small = NetworkManifest.load(paths[0]), NetworkManifest.load(changed(paths[1], input=size))
    head = read_label_head(write_swapping_head(tmp_path / "swap.yaml", paths[0]), once)[0] if headed else None
    twice = NetworkManifest.load(write_classifier(tmp_path, any_size=True, gain=3.0, maps=True, coarse_look=LOOK))
    plain, smaller = (Segmenter(manifest, head=head).logits(photo()) for manifest in (once, small))
    assert (plain.shape[1:], smaller.shape[1:]) == ((16, 24), (7, 10))
    found = Segmenter(twice, head=head).logits(photo())
    np.testing.assert_array_equal(found, with_coarse_look(plain, smaller, LOOK["share"], SKY))
    assert np.abs(found - plain).max() > 0.1, "the stripes are another colour from afar"
    own = Segmenter(once).logits(photo())
    np.testing.assert_array_equal(Segmenter(twice).scores_and_maps(photo())[0], own)  # what heads are taught by
