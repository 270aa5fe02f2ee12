import pytest

from ltm_ros.runtime.health import CameraState, StateRecord

ALIVE, STALLED, NIGHT = CameraState.ALIVE, CameraState.STALLED, CameraState.NIGHT
MOVED, UNAUTHORISED = CameraState.MOVED, CameraState.UNAUTHORISED


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        pytest.param([(1, STALLED)], (STALLED, 1), id="the first failure of a camera that never sent counts"),
        pytest.param([(1, ALIVE), (11, STALLED), (30, STALLED)], (ALIVE, 1), id="failures of 29 s"),
        pytest.param([(1, ALIVE), (11, STALLED), (31, STALLED)], (STALLED, 31), id="failures of 30 s"),
        pytest.param([(1, ALIVE), (11, STALLED), (21, ALIVE), (50, STALLED)], (ALIVE, 1), id="every second one"),
        pytest.param([(1, ALIVE), (31, STALLED), (32, ALIVE)], (ALIVE, 32), id="recovers at once"),
        pytest.param([(1, ALIVE), (2, UNAUTHORISED)], (UNAUTHORISED, 2), id="a rejected password is no accident"),
        pytest.param([(1, ALIVE), (11, NIGHT), (21, ALIVE), (31, NIGHT), (41, ALIVE)], (ALIVE, 1), id="dusk"),
        pytest.param([(1, NIGHT), (31, ALIVE)], (ALIVE, 31), id="morning"),
        pytest.param([(1, STALLED), (2, MOVED), (31, MOVED)], (MOVED, 31), id="another failure"),
    ],
)
def test_states_by_time(seen: list[tuple[int, CameraState]], expected: tuple[CameraState, int]) -> None:
    record = StateRecord(0.0, hold_s=30.0)
    for now, state in seen:
        record.saw(state, float(now), state.value)
    assert (record.state, record.since, record.why) == (*expected, seen[-1][1].value)
