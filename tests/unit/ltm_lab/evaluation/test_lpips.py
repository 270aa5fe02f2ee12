from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ltm_core.base.errors import ModelError
from ltm_lab.evaluation.sim2real.perceptual_io import Lpips, load_arrays


def hand_made() -> dict[str, Any]:
    """An AlexNet of one or two channels a layer that passes on what its middle pixel sees."""
    sizes = [(11, 3, 2), (5, 2, 2), (3, 2, 2), (3, 2, 2), (3, 2, 2)]
    tree: dict[str, Any] = {"AlexNet_0": {}}
    for number, (size, taken, given) in enumerate(sizes):
        kernel = np.zeros((size, size, taken, given), np.float32)
        for channel in range(given):
            kernel[size // 2, size // 2, channel, channel] = 1 if number else 0.458 if channel == 0 else 0.448
        bias = np.array([-0.030, -0.088] if number == 0 else [0, 0], np.float32)
        tree["AlexNet_0"][f"Conv_{number}"] = {"kernel": kernel, "bias": bias}
        linear = np.array([0.5 * (number + 1), 0.25], np.float32)
        tree[f"NetLinLayer_{number}"] = {"Conv_0": {"kernel": linear[None, None, :, None]}}
    return tree


def test_arithmetic_by_hand() -> None:
    pytest.importorskip("torch", reason="LPIPS runs in torch: pip install './ltm_lab[eval]'")
    # The first kernel undoes the normalisation, so every layer holds red and green as they are, in -1 .. 1.
    red, both = np.zeros((64, 67, 3), np.float32), np.zeros((64, 67, 3), np.float32)
    red[..., 0] = 0.6
    both[..., :2] = 0.6, 0.8
    # Unit vectors (1, 0) and (0.6, 0.8): squares of differences 0.16 and 0.64, the same at every place of every layer.
    expected = sum(0.5 * (layer + 1) * 0.16 + 0.25 * 0.64 for layer in range(5))
    lpips = Lpips(hand_made())
    assert lpips.of_range(red, both) == pytest.approx(expected, rel=1e-5)
    assert lpips.of_range(both, both) == 0


def test_a_pickle_of_anything_else_is_refused(tmp_path: Path) -> None:
    tree = {"a": {"b": np.arange(6, dtype=np.float32).reshape(2, 3)}}
    found = load_arrays(io.BytesIO(pickle.dumps(tree)), tmp_path)
    np.testing.assert_array_equal(found["a"]["b"], tree["a"]["b"])
    for evil in (Path, np.load, print):
        with pytest.raises(ModelError, match="not a pickle of NumPy arrays alone"):
            load_arrays(io.BytesIO(pickle.dumps(evil)), tmp_path)
    with pytest.raises(ModelError):
        load_arrays(io.BytesIO(b"\x80"), tmp_path)
