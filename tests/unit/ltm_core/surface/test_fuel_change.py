"""What a changed surface tells the fuel map."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.fuel_change import FuelChange, cover_after, fuel_changes
from ltm_core.surface.layers import SurfaceLayers
from ltm_core.vision.labels import Label

SHAPE = (60, 90)
FUEL = GridGeometry(0.0, 60.0, 30.0, 3, 2)


def layers(
    change: np.ndarray, shift: np.ndarray, label: int = 255, observed: np.ndarray | None = None
) -> SurfaceLayers:
    flat = np.full(SHAPE, 100.0, np.float32)
    seen = np.ones(SHAPE, bool) if observed is None else observed
    seconds = np.where(change > 0, 1_700_000_000, 0).astype(np.uint32)
    return SurfaceLayers(
        GridGeometry(0.0, 60.0, 1.0, SHAPE[1], SHAPE[0]), flat, flat, (flat + shift).astype(np.float32), flat, flat,
        change.astype(np.uint8), seen, seen.astype(np.uint16), seen.astype(np.uint8), seconds, seconds,
        np.where(change > 0, 5, 0).astype(np.uint32), np.full(SHAPE, label, np.uint8),
    )  # fmt: skip


def test_a_fuel_cell_takes_over_what_most_of_its_seen_part_shows() -> None:
    change, shift = np.zeros(SHAPE, int), np.zeros(SHAPE)
    change[0:30, 30:50], shift[0:30, 30:50] = ChangeKind.REMOVED, -11.0  # two thirds of fuel cell (0, 1)
    change[30:35, 0:30], shift[30:35, 0:30] = ChangeKind.GROWN, 5.0  # a sixth of (1, 0): too little
    change[40:60, 60:90], shift[40:60, 60:90] = ChangeKind.LOWERED, -3.0
    removed, moved = fuel_changes(layers(change, shift, Label.BARE), FUEL)
    assert (removed.row, removed.col, removed.change) == (0, 1, FuelChange.REMOVED)
    assert removed.share == pytest.approx(2 / 3)
    assert (removed.shift, removed.cover, removed.cameras, removed.since) == (-11.0, Label.BARE, 5, 1_700_000_000)
    assert (moved.row, moved.col, moved.change, moved.cover) == (1, 2, FuelChange.MOVED_GROUND, Label.BARE)


def test_shares_are_of_what_was_seen_and_little_is_not_enough() -> None:
    change, shift = np.zeros(SHAPE, int), np.zeros(SHAPE)
    change[0:6, 0:20], shift[0:6, 0:20] = ChangeKind.GROWN, 7.0
    observed = np.zeros(SHAPE, bool)
    observed[0:10, 0:20] = True
    (grown,) = fuel_changes(layers(change, shift, observed=observed), FUEL)
    assert (grown.row, grown.col, grown.cover) == (0, 0, Label.TREE)
    assert grown.share == pytest.approx(0.6)
    observed[:] = change > 0
    observed[3:] = False
    small = np.where(np.arange(SHAPE[0])[:, None] < 3, change, 0)
    assert fuel_changes(layers(small, shift, observed=observed), FUEL) == []
    assert fuel_changes(layers(change * 0, shift), FUEL) == []


@pytest.mark.parametrize(
    ("kind", "shift", "label", "cover"),
    [
        (ChangeKind.GROWN, 2.0, 255, Label.SHRUB),
        (ChangeKind.GROWN, 8.0, 255, Label.TREE),
        (ChangeKind.GROWN, 8.0, Label.GRASS, Label.TREE),
        (ChangeKind.GROWN, 8.0, Label.SHRUB, Label.SHRUB),
        (ChangeKind.REMOVED, -8.0, Label.GRASS, Label.GRASS),
        (ChangeKind.REMOVED, -8.0, Label.TREE, None),
        (ChangeKind.REMOVED, -8.0, 255, None),
        (ChangeKind.LOWERED, -8.0, Label.TREE, Label.BARE),
    ],
)
def test_cover_after(kind: ChangeKind, shift: float, label: int, cover: int | None) -> None:
    assert cover_after(kind, shift, np.array([label, label, 255], np.uint8)) == cover
