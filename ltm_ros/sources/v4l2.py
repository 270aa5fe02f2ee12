"""A USB camera at this computer (Video4Linux)."""

from __future__ import annotations

from typing import Any

from ltm_core.source_config import V4l2Config
from ltm_ros.sources.errors import SourceError
from ltm_ros.sources.picture import Timing
from ltm_ros.sources.video import VideoReader


class V4l2Reader(VideoReader):
    """Raises SourceError where PyAV or the device is missing, or belongs to others."""

    def __init__(self, config: V4l2Config) -> None:
        super().__init__(_Device(config), keys_only=True, every=config.every, stall_s=config.stall_s)


class _Device:
    """The `VideoOrigin` of a device. Its pictures carry times of a clock that nobody sets, as a stream's do."""

    def __init__(self, config: V4l2Config) -> None:
        self._config = config

    def opened(self, av: Any) -> Any:
        config = self._config
        asked = {
            "video_size": None if config.size is None else f"{config.size[0]}x{config.size[1]}",
            "framerate": None if config.rate is None else f"{config.rate:g}",
            "input_format": config.format,
        }
        options = {name: value for name, value in asked.items() if value is not None}
        try:
            return av.open(str(config.device), format="v4l2", options=options)
        except PermissionError:
            raise SourceError(f"{config.device} may not be read: add the user to the group video") from None
        except (av.error.FFmpegError, OSError, ValueError) as error:
            asked_for = "".join(f"; {name} {value} was asked for" for name, value in options.items())
            raise SourceError(f"{config.device}: {self.said(error)}{asked_for}") from None

    def timing(self, arrived: float, stream: float | None, begun: float | None) -> Timing:
        return Timing(arrived=arrived, oldest=0.5, stream=stream, least_delay=self._config.least_delay)

    def said(self, error: BaseException) -> str:
        return getattr(error, "strerror", None) or type(error).__name__
