from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
import typer
from packaging.requirements import Requirement
from typer.testing import CliRunner

from ltm_ros.cli.tower import doctor as command
from ltm_ros.launching import shared_memory
from ltm_ros.tower import doctor
from ltm_ros.tower.health_client import DoctorFinding, DoctorState

ANSWER = '{"rmw": "rmw_fastrtps_cpp", "segment_bytes": [70255136, 549408]}'


@pytest.fixture(autouse=True)
def _participant(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a real participant; tests/graph starts one."""
    answer(monkeypatch, 0, ANSWER)


def answer(monkeypatch: pytest.MonkeyPatch, status: int, output: str, error: str = "") -> None:
    done: Any = subprocess.CompletedProcess([], status, output, error)
    monkeypatch.setattr(doctor.subprocess, "run", lambda *_, **__: done)


def found(findings: list[DoctorFinding], name: str) -> DoctorFinding:
    (finding,) = [finding for finding in findings if finding.name == name]
    return finding


def test_package_absent_or_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    versions = {"numpy": "1.20.0", "rich": "15.0"}

    def version(name: str) -> str:
        if name not in versions:
            raise importlib.metadata.PackageNotFoundError(name)
        return versions[name]

    monkeypatch.setattr(doctor.importlib.metadata, "version", version)
    monkeypatch.setattr(
        doctor,
        "requirements",
        lambda: {"": [Requirement("numpy>=1.26"), Requirement("rich")], "view": [Requirement("rerun-sdk>=0.28")]},
    )
    findings = list(doctor.check_packages())
    numpy, rich, rerun = findings
    assert (numpy.state, numpy.detail, numpy.remedy) == (
        DoctorState.MISSING,
        "1.20.0, needed >=1.26",
        "pip install 'numpy>=1.26'",
    )
    assert (rich.state, rich.remedy) == (DoctorState.OK, "")
    assert (rerun.area, rerun.state) == ("packages [view]", DoctorState.OPTIONAL)
    assert rerun.remedy == "pip install 'rerun-sdk>=0.28'"
    assert not doctor.healthy(findings)
    assert doctor.healthy([rich, rerun])


def test_requirements_of_an_installed_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = tmp_path / "ltm-0.1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: ltm\nVersion: 0.1.0\nProvides-Extra: view\nRequires-Dist: numpy>=1.26\n"
        'Requires-Dist: rerun-sdk>=0.28; extra == "view"\n'
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(doctor.ltm_core, "__file__", str(tmp_path / "ltm_core/__init__.py"))
    by_extra = doctor.requirements()
    assert [str(one) for one in by_extra[""]] == ["numpy>=1.26"]
    assert [one.name for one in by_extra["view"]] == ["rerun-sdk"]


def test_participant_with_too_little_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    answer(monkeypatch, 0, '{"rmw": "rmw_fastrtps_cpp", "segment_bytes": [549408]}')
    participant = found(list(doctor.check_transport()), "participant")
    assert participant.state is DoctorState.WARNING
    assert "0.5 MB: too small for images" in participant.detail


def test_small_and_littered_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_memory, "free_bytes", lambda: 64 << 20)
    monkeypatch.setattr(shared_memory, "survey", lambda: shared_memory.SharedMemory(("a",), ("b", "c"), (), 140 << 20))
    room, segments = doctor.check_shared_memory()
    assert (room.state, room.detail) == (DoctorState.WARNING, "64 MB free, enough for 0 nodes")
    assert "--shm-size" in room.remedy
    assert segments.detail == "1 in use, 2 objects of dead processes (140 MB)"
    assert segments.state is DoctorState.WARNING


def test_numba_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    assert doctor.numba_cache() == tmp_path / "kernels"
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "kernels"))
    assert doctor.numba_cache() is None


def test_damaged_model_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    from ltm_core.base.errors import ModelError
    from ltm_core.vision import onnx_model
    from ltm_core.vision.manifest import DEFAULT_MODEL

    def damaged(manifest: object) -> None:
        raise ModelError("checksum is not that of its manifest")

    monkeypatch.setattr(onnx_model, "OnnxModel", damaged)
    default, *others = doctor.check_models()
    assert (default.name, default.state) == (DEFAULT_MODEL, DoctorState.MISSING)
    assert all(other.state is DoctorState.OPTIONAL for other in others)


@pytest.mark.parametrize(
    ("state", "status"), [(DoctorState.MISSING, 1), (DoctorState.WARNING, 0), (DoctorState.OPTIONAL, 0)]
)
def test_exit_code_and_json(monkeypatch: pytest.MonkeyPatch, state: DoctorState, status: int) -> None:
    findings = [
        DoctorFinding("machine", "cores", DoctorState.OK, "2"),
        DoctorFinding("ros", "rclpy", state, "[x] not found", "mend it"),
    ]
    monkeypatch.setattr(doctor, "examine", lambda _: findings)
    app = typer.Typer()
    app.command()(command)
    table = CliRunner().invoke(app)
    assert table.exit_code == status
    assert "[x] not found" in table.output
    assert f"{state} rclpy: mend it" in table.output
    as_json = CliRunner().invoke(app, ["--json"])
    assert as_json.exit_code == status
    content = json.loads(as_json.output)
    assert content["ok"] is (status == 0)
    assert content["findings"][1]["remedy"] == "mend it"
