from __future__ import annotations

from typing import Any

import numpy as np

from ltm_core.geometry.grid import GridGeometry
from ltm_lab.evaluation.pictures.surface_change import KIND_COLORS, SCORE_COLORS, surface_figure

GRID = GridGeometry(-50.0, 80.0, 10.0, 13, 9)


def names(legend: Any) -> list[str]:
    return [text.get_text() for text in legend.get_texts()]


def bar_of(figure: Any, label: str) -> Any:
    """The axes of the colour bar with that label."""
    (found,) = [axes for axes in figure.axes if label in (axes.get_xlabel(), axes.get_ylabel())]
    return found


def surface(**changed: Any) -> dict[str, Any]:
    change = np.zeros(GRID.shape, np.uint8)
    change[2, 3], change[4, 7:9] = 1, 2
    shift = np.select([change == 1, change == 2], [-8.0, 3.0], 0.1).astype(np.float32)
    sigma = np.full(GRID.shape, 1.5, np.float32)
    sigma[:, -2:] = np.nan
    flat = np.full(GRID.shape, 100.0, np.float32)
    return {
        "heights": flat, "sigma": sigma, "shift": shift, "change": change, "seen": np.isfinite(sigma), "geometry": GRID
    } | changed  # fmt: skip


def test_a_sheet_of_changes() -> None:
    truth = np.zeros(GRID.shape, bool)
    truth[4, 8:10] = True
    figure = surface_figure(**surface(), truth=truth)
    moved, sigma, kinds, verdicts = (axes.images[0] for axes in figure.axes[:4])
    for image in (moved, sigma, kinds, verdicts):
        assert image.get_extent() == [-50, 80, -10, 80]
    assert bar_of(figure, "shift (m)").get_xlim() == (-8, 8)
    assert bar_of(figure, "sigma (m)").get_xlim() == (0, 2)
    red, blue, bare = (moved.get_array()[cell].astype(int) for cell in ((2, 3), (4, 7), (0, 0)))
    assert red[0] > red[2] + 30
    assert blue[2] > blue[0] + 15
    assert len(set(bare.tolist())) == 1
    assert np.ptp(sigma.get_array()[0, -1]) == 0 < np.ptp(sigma.get_array()[0, 0])

    def hue(image: Any, row: int, col: int, colors: np.ndarray) -> int:
        """The colour that a tinted cell is nearest to in direction."""
        color = image.get_array()[row, col].astype(float) - 50
        return int(np.argmax(colors @ color / np.linalg.norm(colors, axis=1)))

    assert [hue(kinds, *cell, KIND_COLORS[1:].astype(float)) for cell in ((2, 3), (4, 7))] == [0, 1]
    scored = [hue(verdicts, *cell, SCORE_COLORS.astype(float)) for cell in ((4, 8), (2, 3), (4, 9))]
    assert scored == [0, 1, 2]
    assert kinds.get_array()[0, -1, 0] < kinds.get_array()[0, 0, 0]  # not seen: darker
    assert names(figure.axes[2].get_legend()) == ["removed", "grown", "ground lowered"]
    assert names(figure.axes[3].get_legend()) == ["found", "false", "missed"]
