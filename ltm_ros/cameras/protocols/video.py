"""Read images of video streams (RTSP) and of USB cameras (Video4Linux)."""

from __future__ import annotations

import contextlib
import logging
import re
import socket
import time
from collections.abc import Iterator
from typing import Any, Protocol
from urllib.parse import quote, urlsplit, urlunsplit

from ltm_core.base.types import UInt8Array
from ltm_core.site.source_config import RtspConfig, V4l2Config
from ltm_ros.cameras.protocols.credentials import Login, PictureError, SourceError, UnauthorisedError
from ltm_ros.cameras.protocols.http_wire import Challenge, challenges
from ltm_ros.cameras.protocols.picture import CameraImage, CameraTime, Nothing, Timing

TURN_S = 2.0
"""Seconds after which a call returns without an image, so that its caller can stop."""
_HELD_BACK = ("h264", "hevc")
"""Codecs for which FFmpeg detects a complete image only when the next one begins: an image began to arrive when the
previous one was returned, one period before it is returned itself."""


class VideoOrigin(Protocol):
    """The source of a video."""

    def opened(self, av: Any) -> Any:
        """Open a container of PyAV. Raises SourceError."""
        ...

    def timing(self, arrived: float, stream: float | None, begun: float | None) -> Timing:
        """Return the timing of an image that began to arrive at `arrived`. `stream`: its time in the video, seconds;
        `begun`: epoch seconds of time 0; None: unknown."""
        ...

    def said(self, error: BaseException) -> str:
        """Return an error of FFmpeg in words, without secrets."""
        ...


class VideoReader:
    """Raises SourceError if PyAV is missing, and what `origin` raises.

    Args: keys_only: use only key frames, each decoded alone. every: seconds between images; 0: all. stall_s: seconds
    without an image, while packets come, after which the video is given up."""

    def __init__(self, origin: VideoOrigin, keys_only: bool, every: float, stall_s: float) -> None:
        self.pause = 0.0
        self._origin, self._keys_only, self._every, self._stall_s = origin, keys_only, every, stall_s
        self._av = _pyav()
        self._container = origin.opened(self._av)
        try:
            if not self._container.streams.video:
                raise SourceError("the stream contains no video")
            video = self._container.streams.video[0]
            # Each additional thread delays the output by one image.
            video.codec_context.thread_count = 1
            self._codec = video.codec_context
            self._packets: Iterator[Any] = self._container.demux(video)
        except BaseException:
            self.close()
            raise
        self._held_back = self._codec.name in _HELD_BACK
        self._began: float | None = None
        """Time when the image that is returned next began to arrive."""
        self._due = 0.0
        self._whole = False
        """Whether a key frame has come; other frames need one."""
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
                raise SourceError(f"the stream sends packets, but no image for {arrived - self._last:.0f} s")
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
            raise SourceError(f"the stream was interrupted: {self._origin.said(error)}") from None
        # FFmpeg ends a stream whose server vanished with an empty packet.
        if packet is None or (packet.dts is None and packet.size == 0):
            raise SourceError("the stream has ended: the camera closed it or is not reachable")
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
            raise PictureError("an image of the stream is corrupt")
        self._due = arrived + self._every
        stream = None if frame.pts is None else float(frame.pts * frame.time_base)
        begun = self._container.start_time_realtime
        try:
            rgb: UInt8Array = frame.to_ndarray(format="rgb24")
        except (self._av.error.FFmpegError, ValueError, MemoryError) as error:
            raise PictureError(f"an image of the stream cannot be converted: {self._origin.said(error)}") from None
        return CameraImage(self._origin.timing(arrived, stream, begun / 1e6 if begun else None), rgb=rgb)

    def _decoded(self, packet: Any, alone: bool) -> list[Any]:
        try:
            frames = list(self._codec.decode(packet))
            if alone:
                # Key frames need not wait for later frames that are out of order.
                frames += self._codec.decode(None)
                self._codec.flush_buffers()
        except (self._av.error.FFmpegError, ValueError) as error:
            raise PictureError(f"an image of the stream cannot be decoded: {self._origin.said(error)}") from None
        return frames


def _pyav() -> Any:
    try:
        import av
    except ImportError:
        raise SourceError('video needs PyAV: pip install "ltm[rtsp]"') from None
    av.logging.set_level(None)
    # Its log lines contain URLs.
    logging.getLogger("libav").setLevel(logging.CRITICAL + 1)
    return av


_MOST_HEAD = 16 << 10
_READ_S = 5.0
"""Seconds without a packet after which FFmpeg gives a stream up; cameras send several per second."""
_ANALYSE_US = "1000000"
_STATUS = re.compile(r"method (\w+) failed: (\d{3}) \(([^)\n]{0,60})")
"""What FFmpeg logs if the camera rejects a request."""


class RtspReader(VideoReader):
    """Raises SourceError if PyAV is missing, UnauthorisedError if the password is wrong or cannot be read."""

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
        timeouts = self._config.timeout, min(self._config.timeout, _READ_S)
        av.logging.set_level(av.logging.ERROR)  # for the status of the camera's answer, which no exception holds
        try:
            return av.open(self._address(), options=options, timeout=timeouts)
        except (av.error.HTTPUnauthorizedError, av.error.HTTPForbiddenError):
            raise self._rejected() from None
        except (av.error.FFmpegError, OSError, ValueError) as error:
            status = _STATUS.search(str((getattr(error, "log", None) or ("", "", ""))[2]))
            if status is None:
                raise SourceError(f"no stream: {self.said(error)}") from None
            method, code, words = status.groups()
            said = f"the camera answered {code} {self._login.redact(words)} to RTSP {method}"
            raise SourceError(f"no stream: {said}{self._remedy(code)}") from None
        finally:
            av.logging.set_level(None)

    def _remedy(self, status: str) -> str:
        if status == "461":
            return f"; set transport: {'tcp' if self._config.transport == 'udp' else 'udp'}"
        return "; too many viewers: close other streams" if status == "453" else ""

    def _rejected(self) -> UnauthorisedError:
        """Return the error of a rejected login. FFmpeg knows MD5 alone, and uses the last challenge of several."""
        offers = _challenges_of(self._config) if self._config.user is not None else []
        known = [one for one in offers if one.scheme == "basic" or one.hash_name == "MD5"]
        if offers and (not known or offers[-1] not in known):
            names = ", ".join(map(str, offers))[:200]
            return UnauthorisedError(
                f"the camera offers {names} for RTSP, of which only digest MD5 and basic are supported: select one of "
                "these alone as RTSP authentication in the camera's settings, or use its snapshots (kind: snapshot)"
            )
        return self._login.rejected("RTSP")

    def _address(self) -> str:
        """Return the address with the password; the result is secret."""
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


def _challenges_of(config: RtspConfig) -> list[Challenge]:
    """Return the challenges in a camera's answer to a request without a password; nothing for RTSP over TLS."""
    parts = urlsplit(config.url)
    if parts.scheme != "rtsp":
        return []
    head = b""
    with contextlib.suppress(OSError, ValueError):
        place = parts.hostname or "", parts.port or 554
        with socket.create_connection(place, timeout=config.timeout) as connection:
            connection.sendall(f"DESCRIBE {parts._replace(query='').geturl()} RTSP/1.0\r\nCSeq: 1\r\n\r\n".encode())
            while b"\r\n\r\n" not in head and len(head) < _MOST_HEAD and (part := connection.recv(4096)):
                head += part
    lines = (line.partition(":") for line in head.decode("latin-1").split("\r\n"))
    return challenges(value for name, _, value in lines if name.lower() == "www-authenticate")


class V4l2Reader(VideoReader):
    """Raises SourceError if PyAV or the device is missing, or the device is in use."""

    def __init__(self, config: V4l2Config) -> None:
        super().__init__(_Device(config), keys_only=True, every=config.every, stall_s=config.stall_s)


class _Device:
    """The `VideoOrigin` of a device. Its image times are from a monotonic clock, like a stream's."""

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
            raise SourceError(f"{config.device} is not readable: add the user to the group video") from None
        except (av.error.FFmpegError, OSError, ValueError) as error:
            asked_for = "".join(f"; requested {name} {value}" for name, value in options.items())
            raise SourceError(f"{config.device}: {self.said(error)}{asked_for}") from None

    def timing(self, arrived: float, stream: float | None, begun: float | None) -> Timing:
        return Timing(arrived=arrived, oldest=0.5, stream=stream, least_delay=self._config.least_delay)

    def said(self, error: BaseException) -> str:
        return getattr(error, "strerror", None) or type(error).__name__
