from pathlib import Path

import pytest
from scenes.small_site import write_small_site

from ltm_core.pipeline.kernels import KERNELS
from ltm_core.site.site_io import load_site
from ltm_ros.launching import kernels
from ltm_ros.launching.graph import describe


def test_each_kind_of_node_is_compiled_once_for_a_state_of_the_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = write_small_site(tmp_path, recording=False).path
    graph = describe(load_site(site), site)
    started: list[list[str]] = []

    class Process:
        returncode = 0

        def __init__(self, command: list[str], **_: object) -> None:
            started.append(command[command.index("--kinds") + 1 :])

        poll = wait = kill = lambda self: 0

    monkeypatch.setattr(kernels.subprocess, "Popen", Process)
    monkeypatch.setattr(kernels, "use_own_cache", lambda _: tmp_path)
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "0")
    said: list[str] = []
    for _ in range(2):
        kernels.compile_ahead(graph, site, said.append)
    kinds = [kind for part in started for kind in part]
    assert sorted(kinds) == sorted({node.module.rpartition(".")[2] for node in graph} & set(KERNELS))
    assert "fuel_votes" in kinds
    assert len(said) == 2  # at its begin and at its end
