from __future__ import annotations

import numpy as np
import pytest
from scipy.special import log_softmax

from ltm_core.fuel.cell_appearance_model import SEEN, USUAL, CellAppearanceModel, what_is_seen
from ltm_core.fuel.evidence_kernel import spread
from ltm_core.fuel.frame_evidence import form_by_appearance, shown_forms
from ltm_core.fuel.life_form import FORMS

pytestmark = pytest.mark.kernel

HEIGHT, WIDTH = 17, 26


def cells(rng: np.random.Generator, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Some of a grid's cells, in row-major order."""
    rows, cols = np.divmod(np.flatnonzero(rng.random((HEIGHT, WIDTH)) < share), WIDTH)
    return rows, cols


@pytest.mark.parametrize("share", [0.1, 0.8])
def test_cells_are_told_as_the_model_tells_them(share: float) -> None:
    rng = np.random.default_rng(5)
    rows, cols = cells(rng, share)
    n = len(rows)
    labels = rng.random((n, FORMS)) * (rng.random((n, FORMS)) < 0.5) + 1e-3
    shares = labels / labels.sum(axis=1, keepdims=True)
    weights = rng.normal(0, 3, (FORMS, 3, SEEN))
    weights[[3, 5]] = np.nan  # never tried on these
    look = CellAppearanceModel(np.array([0.1, 0.3, 0.7]), weights)
    bearing = rng.uniform(-np.pi, np.pi, n).astype(np.float32)
    confidence = rng.random(n).astype(np.float32)
    cosine = np.where(rng.random(n) < 0.2, rng.choice([0.1, 0.3, 0.7], n), rng.uniform(0, 1, n))
    least = np.log(0.01)
    own = np.full((n, FORMS), 7.0)
    form_by_appearance(
        *(rows, cols, shares, (confidence - USUAL).astype(np.float64), bearing, cosine),
        *(look.incidence, look.by_incidence, look.known, least, own),
    )
    expected = np.full((n, FORMS), 7.0)
    usual = shares[:, look.known].sum(axis=1) >= 0.5
    seen = what_is_seen(rows, cols, shares, bearing, confidence)
    expected[usual] = np.maximum(log_softmax(look.log_likelihood(seen, cosine)[usual], axis=1), least)
    assert 0 < usual.sum() < n
    np.testing.assert_allclose(own, expected, rtol=1e-9, atol=1e-9)


def test_the_form_that_is_shown() -> None:
    amounts = np.array([[0.1, 0.4, 0.2], [3.0, 3.0, 1.0], [0.0, 2.0, 5.0], [0.0, 0.9, 0.8]])
    most = np.array([1.0, 7.0, 12.0, 1.7])  # the third has less than half of it
    np.testing.assert_array_equal(shown_forms(amounts, most, 0.5), [-1, -1, -1, 1])
    np.testing.assert_array_equal(shown_forms(amounts, np.zeros(4), 0.5), [-1, 0, 2, 1])


def test_spread_over_all_cells_that_may_be_meant() -> None:
    """Against each pair of cells, looked at one by one."""
    rng = np.random.default_rng(7)
    rows, cols = cells(rng, 0.7)
    n = len(rows)
    shares, weights = rng.random((n, FORMS)), rng.uniform(0, 10, n)
    along, across = rng.uniform(0, 5, n), rng.uniform(0, 1.5, n)
    bearing = np.concatenate([rng.uniform(-np.pi, np.pi, n - 4), np.pi / 2 * np.arange(4)])
    found, coverage = spread(rows, cols, shares, weights, along, across, bearing)
    placed = np.maximum(along, across) < 0.25
    np.testing.assert_array_equal(found[placed], shares[placed])
    a, b = np.sqrt(along**2 + 1 / 12), np.sqrt(across**2 + 1 / 12)
    sine, cosine = np.sin(bearing), np.cos(bearing)
    steps = np.mgrid[-20:21, -20:21].reshape(2, -1)
    for i in np.flatnonzero(~placed)[::7]:
        dy, dx = steps
        square = ((dx * sine[i] - dy * cosine[i]) / a[i]) ** 2 + ((dx * cosine[i] + dy * sine[i]) / b[i]) ** 2
        # A cell belongs to the ellipse of 2.5 sigmas, and to the box of whole cells about it.
        box = (
            np.floor(2.5 * np.hypot(a[i] * sine[i], b[i] * cosine[i]) + 0.5),
            np.floor(2.5 * np.hypot(a[i] * cosine[i], b[i] * sine[i]) + 0.5),
        )
        meant = (square <= 6.25) & (np.abs(dx) <= box[0]) & (np.abs(dy) <= box[1])
        places = zip(rows[i] + dy[meant], cols[i] + dx[meant], strict=True)
        share = dict(zip(places, np.exp(-square[meant] / 2), strict=True))
        own = np.array([share.get((r, c), 0.0) for r, c in zip(rows, cols, strict=True)])
        assert coverage[i] == pytest.approx(own.sum() / sum(share.values()))
        np.testing.assert_allclose(found[i], own * weights @ shares / (own @ weights), rtol=1e-9)
