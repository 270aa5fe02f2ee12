"""LabelSet <-> the JSON of the latched topic `labels/info` (std_msgs/String)."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from std_msgs.msg import String

from ltm_core.base.errors import MessageError
from ltm_core.vision.labels import UNLABELLED, LabelSet


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Label(_Strict):
    id: int = Field(ge=0, lt=UNLABELLED)
    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")
    color: list[int] = Field(min_length=3, max_length=3)
    ground_cover: bool


class _LabelInfo(_Strict):
    unlabelled: int
    labels: list[_Label] = Field(min_length=1)
    model: str = Field("", max_length=200)


def label_set_to_msg(labels: LabelSet, model: str = "") -> String:
    """The classes, their colours and their part in votes, as JSON; `model`: what labels, where that is known."""
    return String(data=json.dumps(labels.info() | ({"model": model} if model else {})))


def msg_to_model(msg: Any) -> str:
    """What labels, as a `labels/info` message says; empty where it does not. Raises MessageError on another message."""
    return _checked(msg).model


def _checked(msg: Any) -> _LabelInfo:
    try:
        return _LabelInfo.model_validate_json(msg.data)
    except ValidationError as error:
        where = "; ".join(f"{'.'.join(map(str, e['loc'])) or 'document'}: {e['msg']}" for e in error.errors()[:3])
        raise MessageError(f"labels/info is not a label set: {where}; got {msg.data[:120]!r}") from error
