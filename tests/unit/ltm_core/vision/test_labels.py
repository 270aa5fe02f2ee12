from pathlib import Path

import pytest
import yaml

from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import config_path
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet


def _written(tmp_path: Path, **changes: object) -> Path:
    """The shipped label file with entries replaced (or removed: None)."""
    content = yaml.safe_load(config_path("labels.yaml").read_text())
    for name, entry in changes.items():
        if entry is None:
            del content["labels"][name]
        else:
            content["labels"][name] = entry
    path = tmp_path / "labels.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_shipped_labels_have_the_ids_of_recorded_images() -> None:
    labels = LabelSet.load()
    assert labels.names == ("sky", "grass", "shrub", "tree", "bare", "water", "built")
    assert [labels.id_of(label.name.lower()) for label in Label] == [0, 1, 2, 3, 4, 5, 6]
    assert len(set(labels.colors)) == len(labels)


def test_only_sky_and_unknown_ids_do_not_vote() -> None:
    votes = LabelSet.load().votes_table
    assert votes.nonzero()[0].tolist() == [1, 2, 3, 4, 5, 6]
    assert not votes[UNLABELLED]


def test_a_class_can_be_appended(tmp_path: Path) -> None:
    path = _written(tmp_path, snow={"id": 7, "color": [250, 250, 255], "ground_cover": True})
    labels = LabelSet.load(path)
    assert labels.id_of("snow") == 7
    assert labels.votes_table[7]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sky": {"id": 0, "colour": [1, 2, 3], "ground_cover": False}}, r"labels\.sky\.colour: unknown key"),
        ({"sky": {"id": 0, "color": [1, 2, 3]}}, r"labels\.sky\.ground_cover: missing"),
        ({"grass": {"id": 2, "color": [1, 2, 3], "ground_cover": True}}, r"ids are \[0, 2, 2, 3, 4, 5, 6\]"),
        ({"built": None}, r"labels\.built\.id: found no such label, expected 6"),
        ({"snow": {"id": 9, "color": [1, 2, 3], "ground_cover": True}}, r"each of 0\.\.7 once"),
        ({"water": {"id": 5, "color": [1, 2, 300], "ground_cover": True}}, r"labels\.water\.color.*300"),
    ],
)
def test_a_wrong_file_is_refused_by_the_key_at_fault(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        LabelSet.load(_written(tmp_path, **changes))
