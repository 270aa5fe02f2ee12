"""Profiles of hypothesis: the same examples in each `make test`, new ones in `make fuzz`."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

_SLOW = (HealthCheck.too_slow, HealthCheck.data_too_large)
settings.register_profile("repeatable", derandomize=True, max_examples=40, deadline=None, suppress_health_check=_SLOW)
settings.register_profile("fresh", max_examples=3000, deadline=None, print_blob=True, suppress_health_check=_SLOW)


def pytest_runtest_setup() -> None:
    settings.load_profile("fresh" if os.environ.get("LTM_FUZZ") else "repeatable")
