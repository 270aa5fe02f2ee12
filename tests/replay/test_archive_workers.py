"""`ltm reprocess` by workers that die."""

import json
from functools import partial
from pathlib import Path

import pytest
from scenes.archive_jobs import deadly_work
from scenes.small_site import SmallSite

from ltm_core.base.errors import ArchiveError
from ltm_ros.archive.run import ArchiveOptions, Summary, look_through, run
from ltm_ros.archive.task import Engine, on_workers, serial


def reprocessed(options: ArchiveOptions, engine: Engine = serial) -> Summary:
    return run(look_through(options, lambda done, total: None), engine, lambda done, total: None)


@pytest.mark.slow
def test_a_task_that_kills_its_workers_is_named_and_the_others_end(small_site: SmallSite, tmp_path: Path) -> None:
    """As a decoder's fault does, or too little memory."""
    options = ArchiveOptions((small_site.bag,), small_site.path, tmp_path / "out", frames_per_task=3)
    deadly = look_through(options, lambda done, total: None).tasks[0]
    with pytest.raises(ArchiveError, match=r"3 of 12 frames failed \(3 task\)"):
        reprocessed(options, on_workers(2, partial(deadly_work, deadly.key)))
    record = json.loads((tmp_path / "out/run.json").read_text())
    assert [failure["place"] for failure in record["failures"]] == [deadly.label]
    assert "several workers died of it" in record["failures"][0]["why"]
    assert reprocessed(options).worked == 3
