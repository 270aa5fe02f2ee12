"""Read images of video streams (RTSP)."""

import contextlib
import logging
import re
import socket
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote, urlsplit, urlunsplit

from ltm_core.base.types import UInt8Array
from ltm_core.site.source_config import RtspConfig
from ltm_ros.cameras.protocols.credentials import Login, PictureError, SourceError, UnauthorisedError
from ltm_ros.cameras.protocols.http_wire import Challenge, challenges
from ltm_ros.cameras.protocols.picture import CameraImage, CameraTime, Nothing, Timing

TURN_S = 2.0
"""Seconds after which a call returns without an image, so that its caller can stop."""
_HELD_BACK = ("h264", "hevc")
"""Codecs for which FFmpeg detects a complete image only when the next one begins: an image began to arrive when the
previous one was returned, one period before it is returned itself."""
_MOST_HEAD = 16 << 10
_READ_S = 5.0
"""Seconds without a packet after which FFmpeg gives a stream up; cameras send several per second."""
_STATUS = re.compile(r"method (\w+) failed: (\d{3}) \(([^)\n]{0,60})")
"""What FFmpeg logs if the camera rejects a request."""


class RtspReader:
    """Raises SourceError if PyAV is missing or there is no video, UnauthorisedError if the password is wrong or cannot
    be read."""

    def __init__(self, config: RtspConfig) -> None:
        self.pause = 0.0
        self._config, self._login, self._av = config, Login.of(config), _pyav()
        self._container = self._opened()
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
            if arrived - self._last > self._config.stall_s:
                raise SourceError(f"the stream sends packets, but no image for {arrived - self._last:.0f} s")
            if arrived > until:
                return Nothing.YET

    def close(self) -> None:
        self._container.close()

    def _packet(self) -> Any:
        try:
            packet = next(self._packets, None)
        except (self._av.error.FFmpegError, OSError) as error:
            raise SourceError(f"the stream was interrupted: {self._said(error)}") from None
        # FFmpeg ends a stream whose server vanished with an empty packet.
        if packet is None or (packet.dts is None and packet.size == 0):
            raise SourceError("the stream has ended: the camera closed it or is not reachable")
        return packet

    def _picture(self, packet: Any, arrived: float) -> CameraImage | None:
        self._whole |= packet.is_keyframe
        alone, due = self._config.frames == "key", arrived >= self._due
        if not self._whole or (alone and not (packet.is_keyframe and due)):
            return None
        try:
            frames = list(self._codec.decode(packet))
            if alone:
                # Key frames need not wait for later frames that are out of order.
                frames += self._codec.decode(None)
                self._codec.flush_buffers()
            if not frames or not due:
                return None
            frame = frames[-1]
            if packet.is_corrupt or frame.is_corrupt:
                raise PictureError("an image of the stream is corrupt")
            self._due = arrived + self._config.every
            rgb: UInt8Array = frame.to_ndarray(format="rgb24")
        except (self._av.error.FFmpegError, ValueError, MemoryError) as error:
            raise PictureError(f"an image of the stream cannot be decoded: {self._said(error)}") from None
        stream = None if frame.pts is None else float(frame.pts * frame.time_base)
        begun = self._container.start_time_realtime
        taken = CameraTime(begun / 1e6 + stream, 0.0, "sender-report") if stream is not None and begun else None
        delay, trusted = self._config.least_delay, self._config.clock == "trusted"
        timing = Timing(arrived, oldest=0.5, taken=taken, stream=stream, least_delay=delay, trusted=trusted)
        return CameraImage(timing, rgb=rgb)

    def _opened(self) -> Any:
        av, config = self._av, self._config
        options = {
            "rtsp_transport": config.transport,
            "allowed_media_types": "video",
            "fflags": "nobuffer",
            "analyzeduration": "1000000",
        }
        av.logging.set_level(av.logging.ERROR)  # for the status of the camera's answer, which no exception holds
        try:
            return av.open(self._address(), options=options, timeout=(config.timeout, min(config.timeout, _READ_S)))
        except (av.error.HTTPUnauthorizedError, av.error.HTTPForbiddenError):
            raise self._rejected() from None
        except (av.error.FFmpegError, OSError, ValueError) as error:
            status = _STATUS.search(str((getattr(error, "log", None) or ("", "", ""))[2]))
            if status is None:
                raise SourceError(f"no stream: {self._said(error)}") from None
            method, code, words = status.groups()
            other = "tcp" if config.transport == "udp" else "udp"
            remedies = {"461": f"; set transport: {other}", "453": "; too many viewers: close other streams"}
            said = f"the camera answered {code} {self._login.redact(words)} to RTSP {method}"
            raise SourceError(f"no stream: {said}{remedies.get(code, '')}") from None
        finally:
            av.logging.set_level(None)

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
        user_info = f"{quote(self._config.user, safe='')}:{quote(self._login.secret, safe='')}"
        return urlunsplit(parts._replace(netloc=f"{user_info}@{parts.netloc}"))

    def _said(self, error: BaseException) -> str:
        """Return an error of FFmpeg in words, without secrets."""
        return self._login.redact(getattr(error, "strerror", None) or type(error).__name__)


def _pyav() -> Any:
    try:
        import av
    except ImportError:
        raise SourceError('video needs PyAV: pip install "ltm[rtsp]"') from None
    av.logging.set_level(None)
    # Its log lines contain URLs.
    logging.getLogger("libav").setLevel(logging.CRITICAL + 1)
    return av


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
