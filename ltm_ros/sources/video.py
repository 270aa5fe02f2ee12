"""Pictures of a video that PyAV (extra `rtsp`) reads: a stream of the network, or a camera of this computer."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, Protocol

from ltm_core.types import UInt8Array
from ltm_ros.sources.errors import PictureError, SourceError
from ltm_ros.sources.picture import Nothing, Picture, Timing

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

    def read(self) -> Picture | Nothing:
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

    def _picture(self, packet: Any, arrived: float) -> Picture | None:
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
        return Picture(self._origin.timing(arrived, stream, begun / 1e6 if begun else None), rgb=_rgb(frame))

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
