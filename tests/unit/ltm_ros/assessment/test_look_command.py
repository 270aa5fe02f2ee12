"""`ltm assess look` and `ltm assess learn` as commands."""

import json
from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.site.site_io import load_site
from ltm_ros.assessment.answers_io import Answer, SampledCell, read_plan, write_answers, write_table
from ltm_ros.assessment.look_command import learn, look

DEMO = Path(__file__).parents[4] / "bags/demo"


def test_learn_takes_the_site_of_the_plan_and_names_the_next_commands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = load_site(DEMO / "site.yaml")
    x, y = site.origin[0] + 1500.0, site.origin[1] + 1500.0
    cells = [SampledCell(n, n // 9, n % 9, 0.0, 0.0, x + 90.0 * (n % 9), y - 90.0 * (n // 9)) for n in range(81)]
    about = {"version": 1, "crs": site.crs, "cell_m": 30.0, "site": str(DEMO / "site.yaml")}
    (tmp_path / "plan.json").write_text(json.dumps(about))
    write_table(tmp_path / "cells.csv", list(vars(cells[0])), map(vars, cells))
    plan = read_plan(tmp_path)
    write_answers(plan.answers_file("first"), [Answer(n, "shrub", "sure", 1.0, "") for n in range(81)])
    learn(tmp_path, [DEMO / "recording"])
    learned = plan.learned()
    assert learned
    assert all(cell % 2 == 0 for cell in learned)
    said = capsys.readouterr().out
    assert f"{81 - len(learned)} cells remain" in said
    assert str(tmp_path / "training") in said


def test_look_checks_the_interpreters_name_before_it_reads_recordings(tmp_path: Path) -> None:
    cell = SampledCell(1, 0, 0, 0.0, 0.0, 0.0, 0.0)
    about = {"version": 1, "crs": "EPSG:32611", "cell_m": 30.0, "site": str(DEMO / "site.yaml")}
    (tmp_path / "plan.json").write_text(json.dumps(about))
    write_table(tmp_path / "cells.csv", list(vars(cell)), [vars(cell)])
    with pytest.raises(ConfigError, match=r"\.\./x"):
        look(tmp_path, [tmp_path / "none"], interpreter="../x")
