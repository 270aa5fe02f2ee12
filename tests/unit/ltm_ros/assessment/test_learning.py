"""What the network learns from answers, and which cells then stay out of the report."""

from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.label_heads.labelled_frames import read_frames
from ltm_core.pictures import to_jpeg
from ltm_core.vision.labels import LabelSet
from ltm_ros.assessment.answers_io import Answer, Certainty, Plan, SampledCell, write_answers
from ltm_ros.assessment.cell_photos import CellPhoto
from ltm_ros.assessment.learning import learn


class _OnePhoto:
    """An index in which each cell is a square of 10 pixels in the same photo."""

    def best(self, cell: SampledCell, cell_m: float) -> list[CellPhoto]:
        left = 20.0 * cell.column
        outline = np.array([[left, 20.0], [left + 10, 20.0], [left + 10, 30.0], [left, 30.0]])
        pose = Pose.from_angles((0, 0, 10), 0, 0, 0)
        camera, jpeg = Camera.from_fov(200, 60, 50.0), to_jpeg(np.full((60, 200, 3), 90, np.uint8))
        return [CellPhoto("north", 5, camera, pose, jpeg, outline, 500.0, 60.0)]


def answer(cell: int, form: str, certainty: Certainty = "sure") -> Answer:
    return Answer(cell, form, certainty, 1.0, "2026-06-01T00:00:00+00:00")


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    cells = tuple(SampledCell(10 + n, 0, n, 0.0, 0.0, 0.0, 0.0) for n in range(10))
    return Plan(tmp_path, "EPSG:32611", 30.0, cells, "site.yaml")


def test_half_of_the_agreed_answers_become_areas_and_leave_the_report(plan: Plan) -> None:
    first = [answer(10 + n, "tree" if n < 4 else "grass") for n in range(8)] + [answer(18, "grass", "unsure")]
    write_answers(plan.answers_file("first"), first)
    write_answers(plan.answers_file("second"), [answer(12, "shrub"), answer(14, "grass")])
    found = learn(plan, _OnePhoto())  # type: ignore[arg-type]
    # 12 is disputed and 18 unsure; a report that kept only these of the half would count too many hard cells.
    assert plan.learned() == {10, 12, 14, 16, 18}
    assert (found.cells, found.report_cells) == (3, 4)
    labels = LabelSet.load()
    (frame,) = read_frames(found.folder, len(labels))  # as `ltm train head` reads it
    assert frame.labels[25, 5] == labels.names.index("tree")
    assert frame.labels[25, 85] == frame.labels[25, 125] == labels.names.index("grass")
    assert set(np.unique(frame.labels)) == {labels.names.index("tree"), labels.names.index("grass"), 255}


def test_nothing_to_learn_is_an_error_and_writes_nothing(plan: Plan) -> None:
    write_answers(plan.answers_file("first"), [answer(11, "tree")])
    with pytest.raises(ConfigError):
        learn(plan, _OnePhoto())  # type: ignore[arg-type]
    assert plan.learned() == frozenset()
