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
from ltm_ros.tower.doctor import DoctorFinding, DoctorState


@pytest.fixture(autouse=True)
def _participant(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a real participant; tests/graph starts one."""
    answer(monkeypatch, 0, "rmw_fastrtps_cpp\n")


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
    _, numpy, working, rerun = findings
    assert (numpy.state, numpy.detail, numpy.remedy) == (
        DoctorState.MISSING,
        "1.20.0, needed >=1.26",
        "pip install 'numpy>=1.26'",
    )
    assert (working.state, working.detail, working.remedy) == (DoctorState.OK, "rich 15.0", "")
    assert (rerun.area, rerun.state) == ("packages [view]", DoctorState.OPTIONAL)
    assert rerun.remedy == "pip install 'rerun-sdk>=0.28'"
    assert [json.loads(doctor.as_json(given))["ok"] for given in (findings, [working, rerun])] == [False, True]


def test_requirements_of_an_installed_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = tmp_path / "ltm-0.1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: ltm\nVersion: 0.1.0\nProvides-Extra: view\nRequires-Dist: numpy>=1.26\n"
        'Requires-Dist: rerun-sdk>=0.28; extra == "view"\n'
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    by_extra = doctor.requirements()
    assert [str(one) for one in by_extra[""]] == ["numpy>=1.26"]
    assert [one.name for one in by_extra["view"]] == ["rerun-sdk"]


@pytest.mark.parametrize(
    ("status", "error", "state", "detail"),
    [
        (0, "", DoctorState.OK, "rmw_fastrtps_cpp"),
        (1, "Traceback\nno such middleware", DoctorState.MISSING, "rmw_fastrtps_cpp: no such middleware"),
    ],
)
def test_participant(monkeypatch: pytest.MonkeyPatch, status: int, error: str, state: DoctorState, detail: str) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    answer(monkeypatch, status, "" if error else "rmw_fastrtps_cpp\n", error)
    participant = found(list(doctor.check_transport()), "participant")
    assert (participant.state, participant.detail) == (state, detail)


def test_small_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_memory, "free_bytes", lambda: 64 << 20)
    (room,) = doctor.check_shared_memory()
    assert (room.state, room.detail) == (DoctorState.WARNING, "64 MB free, enough for 0 nodes")
    assert "--shm-size" in room.remedy


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
