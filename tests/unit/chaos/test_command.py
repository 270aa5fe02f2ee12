"""Two runs on one ROS domain would spoil each other's frames."""

from __future__ import annotations

from pathlib import Path

import pytest
from chaos.command import claim


def test_a_domain_belongs_to_one_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with claim(7):
        with pytest.raises(BlockingIOError):
            claim(7)
        with claim(8):
            pass
    with claim(7):
        pass
