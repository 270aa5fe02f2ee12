"""What becomes of a fire model that ends before its time."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltm_core.fire.pyretechnics import VARIABLE, FireModelError, Pyretechnics
from ltm_core.fire.scenario import Moisture, Wind


def test_a_model_that_has_gone_says_so_and_closes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "python"
    script.write_text('#!/bin/sh\necho \'{"version": "1.0"}\'\necho out of memory >&2\n')
    script.chmod(0o755)
    monkeypatch.setenv(VARIABLE, str(script))
    codes = [101] * 100_000  # more than a pipe holds: writing it fails, and so would writing the rest at the end
    with Pyretechnics() as model, pytest.raises(FireModelError, match="out of memory"):
        model.head_rates(codes, Wind(10.0, 45.0), Moisture.parse("D1L1"))
    assert model.version == "1.0"
