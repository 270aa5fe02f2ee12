"""Fixtures that all tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]


def _beside(name: str) -> Path:
    path = REPOSITORY.parent / "shared" / name
    if not path.is_dir():
        pytest.skip(f"needs the real {name} in {path}, which is not part of the repository")
    return path


@pytest.fixture
def shared_data() -> Path:
    """Real test data, where it is present beside the checkout."""
    return _beside("data")


@pytest.fixture
def shared_models() -> Path:
    """Networks made by others, where they are present beside the checkout."""
    return _beside("models")
