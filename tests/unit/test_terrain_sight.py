"""What is kept of fixed views, and what rays pass over quickly, changes nothing of what is found."""

from __future__ import annotations

import numpy as np
import pytest
from terrain_hillside import BARE, LOWERED, PLACES, RAISED, RULES, frame, surface_map

from ltm_core.site import TerrainConfig
from ltm_core.terrain.sight import SIGHT, Sights


def layers(rules: TerrainConfig) -> dict[str, np.ndarray]:
    """After cameras took turns over a surface with a pit and a mound."""
    surface = surface_map(BARE.copy(), rules)
    for hours in (0.0, 1.5, 3.0):
        for source in PLACES:
            surface.add(frame(np.where(BARE > 450.0, RAISED, LOWERED), source, hours))
    surface.decide()
    found = surface.layers()
    return {name: getattr(found, name) for name in ("height", "sigma", "change", "frames", "last_seen")}


def test_views_that_are_kept_and_views_that_are_not_give_the_same() -> None:
    kept, anew = (layers(RULES.model_copy(update={"views_mb": size})) for size in (34.0, 0.0))
    assert (kept["change"] > 0).sum() > 300
    for name in kept:
        np.testing.assert_array_equal(kept[name], anew[name], err_msg=name)


def test_blocks_that_a_ray_passes_above_hold_nothing_that_it_caps(monkeypatch: pytest.MonkeyPatch) -> None:
    quick = layers(RULES)
    monkeypatch.setattr(
        "ltm_core.terrain.observation._block_maxima",
        lambda surface: np.full([-(-n // 8) for n in surface.shape], np.inf, np.float32),
    )
    thorough = layers(RULES)
    for name in quick:
        np.testing.assert_array_equal(quick[name], thorough[name], err_msg=name)


def test_the_views_that_are_kept_are_bounded_and_the_oldest_goes() -> None:
    room = Sights(3 * 6 * 5 * SIGHT.itemsize)
    for key in "abc":
        room.put(key, (6, 5))["place"] = ord(key)
    assert room.get("a") is not None
    room.put("d", (6, 5))["place"] = ord("d")
    assert room.get("b") is None
    for key in "acd":
        sights = room.get(key)
        assert sights is not None
        assert (sights["place"] == ord(key)).all()
    # One that alone is too large is kept by itself.
    assert room.put("large", (60, 50)).shape == (60, 50)
    assert room.get("large") is not None
    assert room.get("a") is None
