import numpy as np
import pytest

from ltm_core.assessment.estimation import allocated, drawn
from ltm_core.base.errors import ConfigError

NAMES = ("sky", "grass", "shrub")


def a_map() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    classes = np.full((64, 64), 1, np.uint8)
    classes[:, 40:] = 2
    changed = np.zeros((64, 64), bool)
    changed[:8, :5] = True
    observed = np.ones((64, 64), bool)
    observed[60:] = False
    return classes, changed, observed


def test_changed_cells_are_oversampled_and_small_strata_taken_whole() -> None:
    counts = allocated([3000, 1000, 40, 5], [False, False, True, True], 300)
    assert sum(counts) == 300
    assert counts[3] == 5
    assert counts[2] == 40
    assert counts[0] > counts[1] > 40


def test_the_same_seed_draws_the_same_observed_cells_of_the_strata() -> None:
    classes, changed, observed = a_map()
    sample, again, other = (drawn(classes, changed, observed, NAMES, 100, seed) for seed in (7, 7, 8))
    assert np.array_equal(sample.rows, again.rows)
    assert not np.array_equal(sample.rows, other.rows)
    assert len(set(zip(sample.rows.tolist(), sample.columns.tolist(), strict=True))) == 100
    assert observed[sample.rows, sample.columns].all()
    for cell in zip(sample.rows, sample.columns, sample.stratum, strict=True):
        stratum = sample.strata[cell[2]]
        assert (classes[cell[:2]], changed[cell[:2]]) == (stratum.map_class, stratum.changed)
    assert [(s.name, s.cells) for s in sample.strata] == [("grass", 2360), ("grass, changed", 40), ("shrub", 1440)]


@pytest.mark.parametrize(("changed", "least", "most"), [(False, 0.0, 0.7), (True, 0.8, 1.2)])
def test_all_cells_have_the_same_chance_and_unchanged_ones_are_spread(changed: bool, least: float, most: float) -> None:
    classes, observed = np.ones((16, 16), np.uint8), np.ones((16, 16), bool)
    times, counts = np.zeros((16, 16)), []
    for seed in range(400):
        sample = drawn(classes, observed & changed, observed, NAMES, 16, seed)
        times[sample.rows, sample.columns] += 1
        counts.append((sample.rows < 8).sum())
    assert times.mean() == 25
    assert times.std() == pytest.approx(np.sqrt(25 * 15 / 16), rel=0.2)
    # 16 cells drawn at random from 256 without segments would vary by the hypergeometric 3.76.
    assert np.mean(counts) == pytest.approx(8, abs=0.3)
    assert least < np.var(counts) / 3.76 < most


def test_half_width_of_one_stratum_is_the_binomial_one() -> None:
    classes, observed = np.ones((100, 100), np.uint8), np.ones((100, 100), bool)
    widths = drawn(classes, ~observed, observed, NAMES, 100, 1).half_widths()
    assert widths["overall"] == pytest.approx(1.96 * np.sqrt(0.8 * 0.2 / 100 * 0.99), rel=1e-4)


def test_too_few_cells_or_nothing_observed_is_an_error() -> None:
    classes, changed, observed = a_map()
    with pytest.raises(ConfigError, match="12"):
        drawn(classes, changed, observed, NAMES, 11, 1)
    with pytest.raises(ConfigError):
        drawn(classes, changed, np.zeros_like(observed), NAMES, 100, 1)
