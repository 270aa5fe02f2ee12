"""A camera's source with a clock that a test turns, and what it delivers."""

import random
from dataclasses import dataclass, field
from typing import Any

from pydantic import TypeAdapter

from ltm_core.geometry.camera import Camera
from ltm_core.site.source_config import SourceConfig
from ltm_ros.cameras.camera_source import CameraDirection, CameraSource, Frame
from ltm_ros.cameras.opening import open_reader
from ltm_ros.runtime.health import Health

MOST_BYTES = 4 << 20
CALIBRATION = Camera.from_fov(320, 180, 62.0)


class TurnedClock:
    """A clock that stands until a test turns it; both its times go on together unless it is `set`."""

    def __init__(self, wall: float = 1_790_000_000.0) -> None:
        self._wall, self._monotonic = wall, 5000.0
        self.known_synchronised: bool | None = True

    def wall(self) -> float:
        return self._wall

    def monotonic(self) -> float:
        return self._monotonic

    def synchronised(self) -> bool | None:
        return self.known_synchronised

    def turn(self, seconds: float) -> None:
        self._wall += seconds
        self._monotonic += seconds

    def set(self, seconds: float) -> None:
        """As somebody who sets the time of day."""
        self._wall += seconds


def settings(**given: Any) -> Any:
    """The section `source` of a site file."""
    adapter: TypeAdapter[Any] = TypeAdapter(SourceConfig)
    return adapter.validate_python(given)


@dataclass
class Sourced:
    """`clock`: with the true times where it is a SystemClock, for a camera that a test runs."""

    config: Any
    clock: Any
    calibration: Camera = CALIBRATION
    gaze: CameraDirection = field(default_factory=CameraDirection)
    reader: Any = None
    """Instead of the one that the configuration asks for."""
    frames: list[Frame] = field(default_factory=list)
    health: Health = field(default_factory=Health)

    def __post_init__(self) -> None:
        def connect() -> Any:
            return self.reader() if self.reader is not None else open_reader(self.config, MOST_BYTES, self.clock)

        self.source = CameraSource(
            self.config,
            self.calibration,
            self.gaze,
            connect,
            self.frames.append,
            self.health,
            self.clock,
            random.Random(5),
        )

    @property
    def state(self) -> str:
        """What the latest request showed; `source.record.state` changes later."""
        return self.source.record.latest.value

    @property
    def why(self) -> str:
        return self.source.record.why

    def steps(self, count: int) -> list[float]:
        """The pauses that followed; the clock does not move."""
        return [self.source.step() for _ in range(count)]
