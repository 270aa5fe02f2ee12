from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from std_msgs.msg import String

from ltm_core.base.errors import MessageError
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.label_info import label_set_to_msg, msg_to_label_set

LABELS = LabelSet(
    names=("sky", "grass", "tree"),
    colors=((70, 130, 180), (1, 2, 3), (0, 255, 9)),
    ground_cover=(False, True, True),
)


@pytest.mark.parametrize("labels", [LABELS, LabelSet.load()], ids=["three", "shipped"])
def test_a_label_set_round_trips(labels: LabelSet) -> None:
    assert msg_to_label_set(label_set_to_msg(labels)) == labels


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda d: d.pop("labels"), "labels"),
        (lambda d: d.update(labels=[]), "labels"),
        (lambda d: d.update(extra=1), "extra"),
        (lambda d: d.update(unlabelled=254), "unlabelled is 254"),
        (lambda d: d["labels"][1].update(id=2), r"\[0, 2, 2\]"),
        (lambda d: d["labels"].pop(1), r"\[0, 2\]"),
        (lambda d: d["labels"][1].update(id="1"), r"labels\.1\.id"),
        (lambda d: d["labels"][1].update(id=-1), r"labels\.1\.id"),
        (lambda d: d["labels"][1].update(name="sky"), "distinct names"),
        (lambda d: d["labels"][1].update(name="tall grass"), r"labels\.1\.name"),
        (lambda d: d["labels"][1].update(color=[1, 2]), r"labels\.1\.color"),
        (lambda d: d["labels"][1].update(color=[1, 2, 256]), r"color of grass is \[1, 2, 256\]"),
        (lambda d: d["labels"][1].update(color=[1, 2, -1]), r"color of grass"),
        (lambda d: d["labels"][1].update(ground_cover="yes"), r"labels\.1\.ground_cover"),
        (lambda d: d["labels"][1].update(fuel="GR2"), r"labels\.1\.fuel"),
    ],
)
def test_anything_else_is_refused_by_key(change: Callable[[dict[str, Any]], object], complaint: str) -> None:
    document = LABELS.info()
    change(document)
    with pytest.raises(MessageError, match=complaint):
        msg_to_label_set(String(data=json.dumps(document)))


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '"sky"'])
def test_what_is_no_json_object_is_refused(text: str) -> None:
    with pytest.raises(MessageError, match="labels/info is not a label set"):
        msg_to_label_set(String(data=text))
