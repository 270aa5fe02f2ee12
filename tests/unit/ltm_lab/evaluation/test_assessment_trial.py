"""Coverage of the intervals over repeated samples; `ltm-lab eval assessment` runs 500."""

from __future__ import annotations

from ltm_lab.evaluation.assessment_trial import coverage, drawn_population


def test_intervals_of_sixty_samples_contain_the_truth() -> None:
    population = drawn_population("clustered", changed=0.01, cluster=3.0, accuracy=0.9)
    found = {row.figure: row for row in coverage(population, 150, 60)}
    assert found["overall accuracy"].truth < 0.85  # the interpreter's errors count
    for row in found.values():
        assert row.covered >= 0.85, row
        assert 0 < row.half_width < 0.3
