import json
from collections.abc import Callable
from typing import Any

import pytest
from std_msgs.msg import String

from ltm_core.base.errors import MessageError
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.json_topics import label_set_to_msg, msg_to_model

LABELS = LabelSet(
    names=("sky", "grass", "tree"), colors=((70, 130, 180), (1, 2, 3), (0, 255, 9)), ground_cover=(False, True, True)
)


def test_the_network_is_named_where_it_is_known() -> None:
    assert msg_to_model(label_set_to_msg(LABELS, "near", "unmeasured")) == "near"
    assert json.loads(label_set_to_msg(LABELS, "near", "unmeasured").data)["reliability"] == "unmeasured"
    assert msg_to_model(label_set_to_msg(LabelSet.load())) == ""


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda d: d.pop("labels"), "labels"),
        (lambda d: d.update(labels=[]), "labels"),
        (lambda d: d.update(extra=1), "extra"),
        (lambda d: d["labels"][1].update(id="1"), r"labels\.1\.id"),
        (lambda d: d["labels"][1].update(id=-1), r"labels\.1\.id"),
        (lambda d: d["labels"][1].update(name="tall grass"), r"labels\.1\.name"),
        (lambda d: d["labels"][1].update(color=[1, 2]), r"labels\.1\.color"),
        (lambda d: d["labels"][1].update(ground_cover="yes"), r"labels\.1\.ground_cover"),
        (lambda d: d["labels"][1].update(fuel="GR2"), r"labels\.1\.fuel"),
    ],
)
def test_anything_else_is_refused_by_key(change: Callable[[dict[str, Any]], object], complaint: str) -> None:
    document = LABELS.info()
    change(document)
    with pytest.raises(MessageError, match=complaint):
        msg_to_model(String(data=json.dumps(document)))
