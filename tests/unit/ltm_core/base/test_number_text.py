import math

import pytest

from ltm_core.base.number_text import NOTHING, difference, number


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(12180.4, 0, "12,180"), (-0.2, 0, "0"), (-0.004, 2, "0.00"), (-1.5, 1, "-1.5"), (math.nan, 0, NOTHING)],
)
def test_number(value: float, digits: int, text: str) -> None:
    assert number(value, digits) == text


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [(445.6, 323.4, "-123"), (0.3, 0.4, "0"), (10.4, 10.6, "+1"), (10.2, 10.4, "0"), (0.0, 2000.0, "+2,000")],
)
def test_a_difference_is_of_the_numbers_as_they_are_shown(before: float, after: float, text: str) -> None:
    assert difference(before, after) == text
    shown = [int(number(value).replace(",", "")) for value in (before, after)]
    assert int(text.replace(",", "")) == shown[1] - shown[0]
