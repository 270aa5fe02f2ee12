"""What a picture's skyline says of a turn of its camera <-> std_msgs/String, in JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError
from std_msgs.msg import String

from ltm_core.base.errors import MessageError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array
from ltm_core.pose_estimation.mount.skyline_turns import SKYLINE_TURNS, TURN_STEP, SkylineTurns

_LARGEST = 16_384
"""Characters: they are some 1000."""
_MOST = 1e5
"""Of a logarithm: a skyline has a few hundred columns."""


@dataclass(frozen=True, eq=False)
class ToldTurns:
    """`rotation`: (3,) rad, of the correction (`PoseCorrection`) with which the camera's pose was published."""

    camera: str
    rotation: Float64Array
    turns: SkylineTurns


_Angle = Annotated[float, Field(ge=-360, le=360)]


class _Wire(StrictModel):
    camera: str = Field(min_length=1, max_length=200)
    stamp_ns: int = Field(ge=0, lt=2**63)
    azimuth_deg: _Angle
    hfov_deg: float = Field(gt=0, lt=180)
    rotation_deg: tuple[_Angle, _Angle, _Angle]
    step_deg: float
    log_likelihood: list[Annotated[float, Field(ge=-_MOST, le=_MOST)]] = Field(
        min_length=len(SKYLINE_TURNS), max_length=len(SKYLINE_TURNS)
    )
    """By the angle by which the published azimuth is too great: steps of `step_deg`, 0 in the middle."""


def turns_to_msg(told: ToldTurns) -> String:
    turns = told.turns
    wire = _Wire(
        camera=told.camera,
        stamp_ns=turns.stamp_ns,
        azimuth_deg=round(math.degrees(turns.azimuth), 4),
        hfov_deg=round(math.degrees(turns.hfov), 4),
        rotation_deg=tuple(np.degrees(told.rotation).round(4).tolist()),
        step_deg=round(math.degrees(TURN_STEP), 4),
        log_likelihood=turns.logs.round(3).tolist(),
    )
    return String(data=wire.model_dump_json())


def msg_to_turns(msg: Any, camera: str) -> ToldTurns:
    """Raises MessageError: not what the node `pose` of that camera tells."""
    if len(msg.data) > _LARGEST:
        raise MessageError(f"{len(msg.data)} characters are no turns of a skyline, which take {_LARGEST} at most")
    try:
        wire = _Wire.model_validate_json(msg.data)
    except ValidationError as error:
        found = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()[:3])
        raise MessageError(f"not what the node `pose` tells of a skyline's turns ({found})") from error
    if wire.camera != camera or abs(wire.step_deg - math.degrees(TURN_STEP)) > 1e-6:
        raise MessageError(
            f"turns of camera {wire.camera!r} in steps of {wire.step_deg:g} deg, wanted {camera!r} and "
            f"{math.degrees(TURN_STEP):g}: do both nodes have one version?"
        )
    logs = np.array(wire.log_likelihood)
    turns = SkylineTurns(wire.stamp_ns, math.radians(wire.azimuth_deg), math.radians(wire.hfov_deg), logs)
    return ToldTurns(wire.camera, np.radians(wire.rotation_deg), turns)
