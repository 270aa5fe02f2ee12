"""How many examples hypothesis draws where each costs more than a hundredth of a second."""

import os

from hypothesis import settings


def examples(count: int, in_fuzz: int) -> settings:
    """`count` in each test run, the same each time; `in_fuzz` in `make fuzz`, which draws new ones."""
    return settings(max_examples=in_fuzz if os.environ.get("LTM_FUZZ") else count, deadline=None)
