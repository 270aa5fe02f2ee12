"""Coverage of the intervals over repeated samples; `ltm-lab eval assessment` runs 500."""

from __future__ import annotations

import numpy as np

from ltm_lab.evaluation.assessment_trial import FEWEST_EVENTS, coverage, drawn_population


def test_intervals_of_sixty_samples_contain_the_truth() -> None:
    population = drawn_population("clustered", changed=0.01, cluster=3.0, accuracy=0.9)
    found = {row.figure: row for row in coverage(population, 150, 60)}
    assert found["overall accuracy"].truth < 0.85  # the interpreter's errors count
    for row in found.values():
        assert row.covered >= 0.85, row
        assert 0 < row.half_width < 0.3
    assert 0.9 <= np.mean([row.covered for row in found.values()]) <= 0.98


def test_events_of_a_map_with_rare_errors() -> None:
    """Of 14,400 cells a fifth of 144 changes is missed: 0.2 % of about 200 sampled cells of unchanged strata."""
    found = {row.figure: row for row in coverage(drawn_population("rare", changed=0.01, errors=0.0), 300, 1)}
    assert 0.3 < found["producer's accuracy of change"].events < FEWEST_EVENTS
    assert found["user's accuracy of change"].events > FEWEST_EVENTS
