"""A camera's video stream over the network (RTSP)."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote, urlsplit, urlunsplit

from ltm_core.source_config import RtspConfig
from ltm_ros.sources.credentials import Login
from ltm_ros.sources.errors import SourceError, UnauthorisedError
from ltm_ros.sources.picture import CameraTime, Timing
from ltm_ros.sources.video import VideoReader

_READ_S = 5.0
"""Without a packet, after which FFmpeg gives a stream up: cameras send some each second."""
_ANALYSE_US = "1000000"


class RtspReader(VideoReader):
    """Raises SourceError where PyAV is missing, UnauthorisedError where the password is wrong or cannot be read."""

    def __init__(self, config: RtspConfig) -> None:
        super().__init__(_Stream(config), config.frames == "key", config.every, config.stall_s)


class _Stream:
    """The `VideoOrigin` of a stream."""

    def __init__(self, config: RtspConfig) -> None:
        self._config = config
        self._login = Login.of(config)

    def opened(self, av: Any) -> Any:
        options = {
            "rtsp_transport": self._config.transport,
            "allowed_media_types": "video",
            "fflags": "nobuffer",
            "analyzeduration": _ANALYSE_US,
        }
        try:
            return av.open(
                self._address(), options=options, timeout=(self._config.timeout, min(self._config.timeout, _READ_S))
            )
        except (av.error.HTTPUnauthorizedError, av.error.HTTPForbiddenError):
            raise UnauthorisedError(
                f"the camera refuses the user {self._config.user or '(none)'}: mend user and password"
            ) from None
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise SourceError(f"no stream: {self.said(error)}") from None

    def _address(self) -> str:
        """A secret from here on."""
        url = self._login.filled(self._config.url)
        if self._config.user is None or "{password}" in self._config.url:
            return url
        parts = urlsplit(url)
        password = self._login.password.reveal() if self._login.password is not None else ""
        user_info = f"{quote(self._config.user, safe='')}:{quote(password, safe='')}"
        return urlunsplit(parts._replace(netloc=f"{user_info}@{parts.netloc}"))

    def timing(self, arrived: float, stream: float | None, begun: float | None) -> Timing:
        taken = None
        if stream is not None and begun is not None:
            taken = CameraTime(begun + stream, 0.0, "sender-report")
        return Timing(
            arrived=arrived,
            oldest=0.5,
            taken=taken,
            stream=stream,
            least_delay=self._config.least_delay,
            trusted=self._config.clock == "trusted",
        )

    def said(self, error: BaseException) -> str:
        return self._login.redact(getattr(error, "strerror", None) or type(error).__name__)
