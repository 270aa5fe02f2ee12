"""What charts and sheets show, by the data of their axes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.evaluation.pictures.depth_sheet import depth_sheet
from ltm_lab.evaluation.pictures.figure import picture_of
from ltm_lab.evaluation.pictures.surface_change import KIND_COLORS, SCORE_COLORS, surface_figure
from ltm_lab.training.curve_io import training_figure

GRID = GridGeometry(-50.0, 80.0, 10.0, 13, 9)


def names(legend: Any) -> list[str]:
    return [text.get_text() for text in legend.get_texts()]


def bar_of(figure: Any, label: str) -> Any:
    """The axes of the colour bar with that label."""
    (found,) = [axes for axes in figure.axes if label in (axes.get_xlabel(), axes.get_ylabel())]
    return found


def test_a_training_s_curves() -> None:
    losses = np.linspace(3.0, 1.0, 101)
    loss, score = training_figure("tiny", losses, [(50, 0.25), (100, 0.75)]).axes
    steps, mean = loss.lines
    np.testing.assert_allclose(steps.get_xydata(), np.column_stack([np.arange(1, 102), losses]))
    # The mean over 25 steps of a straight line lies on the line.
    assert mean.get_xdata()[[0, -1]].tolist() == [13, 89]
    np.testing.assert_allclose(mean.get_ydata(), np.interp(mean.get_xdata(), np.arange(1, 102), losses))
    assert score.lines[0].get_xydata().tolist() == [[50, 0.25], [100, 0.75]]
    assert names(loss.figure.legends[0]) == ["loss of a step", "mean over 25 steps", "validation: mean F1"]


def test_a_training_that_has_just_begun_has_a_chart() -> None:
    (axes,) = training_figure("tiny", [], []).axes
    assert [len(line.get_xdata()) for line in axes.lines] == [0]
    (axes,) = training_figure("tiny", [2.0, 1.0], []).axes
    assert axes.lines[1].get_xydata().tolist() == [[1.5, 1.5]]


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


def test_titles_are_within_the_picture() -> None:
    """Nothing is drawn on its edges, whatever the shape of the map."""
    for rows, cols, known in ((30, 100, True), (82, 100, True), (82, 100, False), (100, 82, True)):
        flat = np.full((rows, cols), 100.0, np.float32)
        change = np.zeros(flat.shape, np.uint8)
        change[3:6, 4:9] = 1
        grid = GridGeometry(0.0, float(rows), 1.0, cols, rows)
        truth = change > 0 if known else None
        figure = surface_figure(flat, flat / 100, flat - 105, change, change < 2, grid, truth)
        picture = picture_of(figure)
        for edge in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
            assert (edge == 255).all(), (rows, cols, known)


def test_a_sheet_of_changes_without_truth_or_without_change() -> None:
    still = surface(change=np.zeros(GRID.shape, np.uint8), sigma=np.full(GRID.shape, np.nan, np.float32))
    figure = surface_figure(**still)
    assert not figure.axes[3].get_visible()
    assert bar_of(figure, "shift (m)").get_xlim() == (-1, 1)
    assert picture_of(figure).shape[2] == 3
    with pytest.raises(RasterError, match=r"sigma of \(9, 12\) does not fit"):
        surface_figure(**surface(sigma=np.zeros((9, 12), np.float32)))


def test_a_sheet_of_depths() -> None:
    truth = np.full((40, 70), 400.0, np.float32)
    truth[:10] = np.inf
    traced, network = truth * np.float32(1.1), truth * np.float32(0.6)
    network[30] = np.nan
    photo = np.full((80, 140, 3), 90, np.uint8)
    sources = {"traced": traced, "network": network, "fused": truth}
    sheet = depth_sheet("oak", photo, sources, truth)
    smaller = depth_sheet("oak", photo, {"fused": truth}, truth)
    alone = depth_sheet("oak", photo, {"fused": truth}, None)
    assert sheet.shape[0] > smaller.shape[0] > alone.shape[0]
    assert sheet.shape[1:] == alone.shape[1:]
