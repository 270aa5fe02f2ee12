import numpy as np
import pytest
from scipy.stats import beta

from ltm_core.assessment.estimation import StratifiedSample, assessed, joined, kappa

OLOFSSON = np.array([[66, 0, 5, 4], [0, 55, 8, 12], [1, 0, 153, 11], [2, 1, 9, 313]])
"""Sample counts of Olofsson et al. (2014), table 8: deforestation, forest gain, stable forest, stable non-forest."""
PIXELS = 10**4 * np.array([200_000, 150_000, 3_200_000, 6_450_000])
"""Mapped pixels, 10,000 for each of the paper's, whose formulas do not correct for finite populations."""
HECTARES = 900_000


def test_olofsson_2014() -> None:
    mapped, reference = (np.repeat(axis.ravel(), OLOFSSON.ravel()) for axis in np.indices((4, 4)))
    found = assessed(StratifiedSample(mapped, PIXELS), mapped, reference, 4)
    # Table 9: error matrix of area proportions.
    printed = [[0.0176, 0, 0.0013, 0.0011], [0, 0.0110, 0.0016, 0.0024]]
    printed += [[0.0019, 0, 0.2967, 0.0213], [0.0040, 0.0020, 0.0179, 0.6212]]
    np.testing.assert_allclose(found.matrix, printed, atol=5.1e-5)
    # Page 54: accuracies with half-widths of their 95 % intervals. Of the producer's accuracies the paper prints half-
    # widths of 0.23 and 0.01 for the second and last class; its equation 7 gives 0.25 and 0.02 with these counts.
    for estimates, values, widths in (
        ([found.overall], [0.95], [0.02]),
        (found.users, [0.88, 0.73, 0.93, 0.96], [0.07, 0.10, 0.04, 0.02]),
        (found.producers, [0.75, 0.85, 0.93, 0.96], [0.21, 0.25, 0.03, 0.02]),
    ):
        assert [round(e.value, 2) for e in estimates] == values
        assert [round(1.96 * e.error, 2) for e in estimates] == widths
    # Page 54: pixels of deforestation, and hectares of all classes.
    pixels = found.area[0].times(10**7)
    assert (round(pixels.value), round(1.96 * pixels.error)) == (235_086, 68_418)
    hectares = [area.times(HECTARES) for area in found.area]
    assert [round(area.value) for area in hectares] == [21_158, 11_686, 285_770, 581_386]
    assert [round(1.96 * area.error) for area in hectares] == [6158, 3756, 15_510, 16_282]


def test_stehman_2014_strata_that_are_not_map_classes() -> None:
    # Table 2 and pages 4932 to 4936 of the paper.
    a, b, c, d = range(4)
    mapped = np.array([a] * 7 + [b] * 3 + [a] + [b] * 11 + [c] * 6 + [b, b] + [d] * 10)
    reference = np.array(
        [a] * 5 + [c, b, a, b, c, a] + [b] * 5 + [a, a, b, b] + [c] * 5 + [d, d, b, b, a] + [d] * 7 + [c, c, b]
    )
    sizes = np.array([40_000, 30_000, 20_000, 10_000])
    found = assessed(StratifiedSample(np.repeat(np.arange(4), 10), sizes), mapped, reference, 4)
    values = [found.area[a], found.area[c], found.overall, found.users[b], found.producers[b]]
    assert [round(v.value, 3) for v in values] == [0.35, 0.2, 0.63, 0.574, 0.794]
    assert [round(v.error, 3) for v in values] == [0.082, 0.064, 0.085, 0.125, 0.117]
    assert found.matrix[b, c] == pytest.approx(0.08)


def test_a_census_has_no_error_and_a_sample_without_errors_has_an_interval() -> None:
    stratum = np.zeros(20, np.int64)
    right = np.ones(20, np.bool_)
    whole = StratifiedSample(stratum, np.array([20])).ratio(right, right, "whole")
    assert (whole.value, whole.low, whole.high) == (1, 1, 1)
    part = StratifiedSample(stratum, np.array([100_000])).ratio(right, right, "whole")
    # Jeffreys' interval: the 2.5 % quantile of Beta(20.5, 0.5).
    assert (part.value, part.high) == (1, 1)
    assert part.low == pytest.approx(beta.ppf(0.025, 20.5, 0.5), abs=1e-3)
    assert part.approximate
    assert not whole.approximate


def test_an_unseen_error_counts_in_the_stratum_where_a_cell_weighs_most() -> None:
    """20 right cells of each of two strata: an unseen error has the weight of a cell of the larger one."""
    stratum, right = np.repeat([0, 1], 20), np.ones(40, np.bool_)
    low = [
        StratifiedSample(stratum, np.array(sizes)).ratio(right, right, "whole").low
        for sizes in ([10**6, 10**6], [10**6, 3 * 10**6], [3 * 10**6, 10**6])
    ]
    assert low[1] == pytest.approx(low[2], rel=1e-9)
    # Beta's quantiles with the mean and variance that one unseen error of half, and of 3/4, of a cell's weight gives.
    assert low[0] == pytest.approx(0.942, abs=0.002)
    assert low[1] == pytest.approx(1 - 1.5 * (1 - low[0]), abs=0.005)


@pytest.mark.parametrize(
    ("errors", "sizes", "events"),
    [(10, (1, 1), 20.0), (10, (1, 3), 10 * (1 + 9) ** 3 / (1 + 27) ** 2), (3, (1, 1), 6.0)],
)
def test_events_are_the_effective_number_of_errors(errors: int, sizes: tuple[int, int], events: float) -> None:
    """Two strata with as many errors: those of equal weight are counted, others less."""
    right = np.tile(np.arange(10**4) >= errors, 2)
    sample = StratifiedSample(np.repeat([0, 1], 10**4), 10**8 * np.array(sizes))
    found = sample.ratio(right, np.ones_like(right), "whole")
    assert found.events == pytest.approx(events, rel=0.01)
    assert found.approximate == (errors == 3)


def test_strata_without_answers_are_joined() -> None:
    sample = joined(np.array([0, 0, 0, 2, 2, 3]), [500, 40, 60, 1])
    assert sample.sizes.tolist() == [500, 100, 1]
    assert sample.stratum.tolist() == [0, 0, 0, 1, 1, 2]


def test_kappa() -> None:
    # Cohen (1960) by hand: agreement 0.7, chance 0.5.
    first, second = np.repeat([0, 0, 1, 1], [35, 15, 15, 35]), np.repeat([0, 1, 0, 1], [35, 15, 15, 35])
    assert kappa(first, second, 2) == pytest.approx((0.7, 0.4))
