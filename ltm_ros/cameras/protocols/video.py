"""Read images of video streams (RTSP) and of USB cameras (Video4Linux)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, Protocol
from urllib.parse import quote, urlsplit, urlunsplit

from ltm_core.base.types import UInt8Array
from ltm_core.site.source_config import RtspConfig, V4l2Config
from ltm_ros.cameras.protocols.credentials import Login, PictureError, SourceError, UnauthorisedError
from ltm_ros.cameras.protocols.picture import CameraImage, CameraTime, Nothing, Timing

TURN_S = 2.0
"""After which a call returns without a picture, so that its caller can end."""
_HELD_BACK = ("h264", "hevc")
"""Codecs of which FFmpeg knows that a picture is whole only when the next one begins: a picture began to arrive when
the one before was handed out, a period before it is handed out itself."""


class VideoOrigin(Protocol):
    """Where a video comes from."""

    def opened(self, av: Any) -> Any:
        """A container of PyAV. Raises SourceError."""
        ...

    def timing(self, arrived: float, stream: float | None, begun: float | None) -> Timing:
        """Of a picture that began to arrive at `arrived`. `stream`: its time as the video counts it, seconds; `begun`:
        when that was 0, seconds since the epoch; None: not told."""
        ...

    def said(self, error: BaseException) -> str:
        """An error of FFmpeg in words, without a secret."""
        ...


class VideoReader:
    """Raises SourceError where PyAV is missing, and what `origin` raises.

    Args:
        keys_only: pictures that are whole in themselves, each decoded alone.
        every: seconds from one picture to the next; 0: all.
        stall_s: without a picture, while packets come, after which the video is of no use.
    """

    def __init__(self, origin: VideoOrigin, keys_only: bool, every: float, stall_s: float) -> None:
        self.pause = 0.0
        self._origin, self._keys_only, self._every, self._stall_s = origin, keys_only, every, stall_s
        self._av = _pyav()
        self._container = origin.opened(self._av)
        try:
            if not self._container.streams.video:
                raise SourceError("the stream has no video")
            video = self._container.streams.video[0]
            # With more threads a picture comes out as many pictures later.
            video.codec_context.thread_count = 1
            self._codec = video.codec_context
            self._packets: Iterator[Any] = self._container.demux(video)
        except BaseException:
            self.close()
            raise
        self._held_back = self._codec.name in _HELD_BACK
        self._began: float | None = None
        """When the picture that is handed out next began to arrive."""
        self._due = 0.0
        self._whole = False
        """Whether a key frame has come, without which the others show nothing."""
        self._last = time.monotonic()

    def read(self) -> CameraImage | Nothing:
        until = time.monotonic() + TURN_S
        while True:
            packet = self._packet()
            arrived = time.monotonic()
            began, self._began = self._began, arrived
            if self._held_back and began is None:
                continue
            picture = self._picture(packet, began if self._held_back and began is not None else arrived)
            if picture is not None:
                self._last = arrived
                return picture
            if arrived - self._last > self._stall_s:
                raise SourceError(f"packets, but no picture for {arrived - self._last:.0f} s")
            if arrived > until:
                return Nothing.YET

    def close(self) -> None:
        self._container.close()

    def _packet(self) -> Any:
        try:
            packet = next(self._packets)
        except StopIteration:
            packet = None
        except (self._av.error.FFmpegError, OSError) as error:
            raise SourceError(f"the stream breaks off: {self._origin.said(error)}") from None
        # FFmpeg ends a stream whose server is gone without a word, with a packet that holds nothing.
        if packet is None or (packet.dts is None and packet.size == 0):
            raise SourceError("the stream has ended: the camera is gone, or has closed it")
        return packet

    def _picture(self, packet: Any, arrived: float) -> CameraImage | None:
        self._whole |= packet.is_keyframe
        due = arrived >= self._due
        if not self._whole or (self._keys_only and not (packet.is_keyframe and due)):
            return None
        frames = self._decoded(packet, self._keys_only)
        if not frames or not due:
            return None
        frame = frames[-1]
        if packet.is_corrupt or frame.is_corrupt:
            raise PictureError("a picture of the stream is damaged")
        self._due = arrived + self._every
        stream = None if frame.pts is None else float(frame.pts * frame.time_base)
        begun = self._container.start_time_realtime
        return CameraImage(self._origin.timing(arrived, stream, begun / 1e6 if begun else None), rgb=_rgb(frame))

    def _decoded(self, packet: Any, alone: bool) -> list[Any]:
        try:
            frames = list(self._codec.decode(packet))
            if alone:
                # What is whole in itself need not wait for what follows, in case of pictures out of order.
                frames += self._codec.decode(None)
                self._codec.flush_buffers()
        except (self._av.error.FFmpegError, ValueError) as error:
            raise PictureError(f"a picture of the stream cannot be decoded: {self._origin.said(error)}") from None
        return frames


def _pyav() -> Any:
    try:
        import av
    except ImportError:
        raise SourceError('video needs PyAV: pip install "ltm[rtsp]"') from None
    av.logging.set_level(None)  # its lines hold URLs
    return av


def _rgb(frame: Any) -> UInt8Array:
    array: UInt8Array = frame.to_ndarray(format="rgb24")
    return array


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
