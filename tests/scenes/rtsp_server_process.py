"""An RTSP camera: `/usr/bin/python3 rtsp_server_process.py PORT [--ahead S] [--password P]`, on GStreamer's server.

For the system's Python, which has GStreamer's bindings; knows nothing of ours. Serves H.264 with sender reports at
`/live`; each picture shows when it was made in milliseconds, as black and white squares (`scenes.timed_picture`).
`--i420`: a file of one picture, which it shows instead, with noise and without the time. `--ahead`: by how much the
camera's clock, which its sender reports tell, is wrong; its pictures show the true time.
Prints `ready`.
"""

import argparse
import random
import threading
import time
from pathlib import Path
from typing import Any

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtsp", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, GObject, Gst, GstRtsp, GstRtspServer  # noqa: E402

RATE = 10
BITS, SQUARE, ACROSS = 44, 16, 11
NTP_EPOCH_S = 2_208_988_800
"""From 1900 to 1970."""
CLOCK_TIME = 3
"""Of rtpbin: sender reports tell the pipeline's clock."""


def noisy_scenes(count: int, width: int, height: int, shown: bytes = b"") -> list[bytes]:
    """Pictures as I420: what is `shown`, or squares of several greys and colours, with another noise in each."""
    colours = b"".join(
        bytes((60 + 40 * (row // 24) + 30 * (column // 40)) % 160 + 40 for column in range(width // 2))
        for row in range(height // 2)
    )
    rows = {
        at: bytes((70 * at + 45 * (column // 40)) % 150 + 50 for column in range(width))
        for at in range(-(-height // 32))
    }
    grey = int.from_bytes(b"".join(rows[row // 32] for row in range(height)), "big")
    size, scenes = width * height, []
    colours += colours[::-1]
    if shown:
        grey, colours = int.from_bytes(shown[:size], "big"), shown[size:]
    mask = int.from_bytes(b"\x07" * size, "big")
    for seed in range(count):
        noise = int.from_bytes(random.Random(seed).randbytes(size), "big") & mask
        scenes.append((grey + noise).to_bytes(size, "big") + colours)
    return scenes


def picture(scene: bytes, width: int, moment: float) -> bytes:
    """`moment`: seconds since the epoch, which it shows."""
    image = bytearray(scene)
    count = round(moment * 1000)
    for bit in range(BITS):
        row, column = divmod(bit, ACROSS)
        value = bytes([235 if count >> bit & 1 else 16]) * SQUARE
        for line in range(row * SQUARE, (row + 1) * SQUARE):
            begin = line * width + column * SQUARE
            image[begin : begin + SQUARE] = value
    return bytes(image)


def clock_ahead(seconds: float) -> Any:
    """This computer's time of day as NTP counts it, and so much more."""
    clock = GObject.new(Gst.SystemClock, name="camera", clock_type=Gst.ClockType.REALTIME)
    clock.set_calibration(0, round((NTP_EPOCH_S + seconds) * Gst.SECOND), 1, 1)
    return clock


def tell_pipeline_clock(pipeline: Any, inside: Any, element: Any) -> None:
    if element.get_factory().get_name() == "rtpbin":
        element.set_property("ntp-time-source", CLOCK_TIME)


class Live(GstRtspServer.RTSPMediaFactory):
    def __init__(self, ahead: float, keys: int, width: int, height: int, shown: bytes) -> None:
        super().__init__()
        self.scenes, self.width, self.tells_time = noisy_scenes(8, width, height, shown), width, not shown
        self.set_clock(clock_ahead(ahead))
        self.set_shared(True)
        self.set_launch(
            f"( appsrc name=src is-live=true do-timestamp=true format=time "
            f"caps=video/x-raw,format=I420,width={width},height={height},framerate={RATE}/1 ! "
            f"x264enc tune=zerolatency speed-preset=ultrafast bitrate=4000 key-int-max={keys} ! "
            "rtph264pay name=pay0 pt=96 config-interval=1 )"
        )

        self.connect("media-configure", self.feed)

    def feed(self, factory: Any, media: Any) -> None:
        media.get_element().get_parent().connect("deep-element-added", tell_pipeline_clock)
        source = media.get_element().get_child_by_name("src")

        def push() -> None:
            number, due, first, first_ns = 0, time.monotonic(), time.time(), None
            while True:
                clock = source.get_clock()
                if first_ns is None:
                    first = time.time() - number / RATE
                    if clock is not None:
                        first_ns = clock.get_time() - source.get_base_time() - number * Gst.SECOND // RATE
                scene = self.scenes[number % len(self.scenes)]
                shows = picture(scene, self.width, first + number / RATE) if self.tells_time else scene
                made = Gst.Buffer.new_wrapped(shows)
                if first_ns is not None:
                    # Taken at its turn, as by a sensor: a busy computer sends it late, with the time that it shows.
                    made.pts = max(0, first_ns + number * Gst.SECOND // RATE)
                if source.emit("push-buffer", made) == Gst.FlowReturn.EOS:
                    return
                number, due = number + 1, due + 1 / RATE
                time.sleep(max(0.0, due - time.monotonic()))

        threading.Thread(target=push, daemon=True).start()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("port")
    parser.add_argument("--ahead", type=float, default=0.0)
    parser.add_argument("--password", default="")
    parser.add_argument("--digest", action="store_true")
    parser.add_argument("--keys", type=int, default=10)
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--height", type=int, default=192)
    parser.add_argument("--i420", type=Path)
    options = parser.parse_args()
    Gst.init(None)
    server = GstRtspServer.RTSPServer(address="127.0.0.1", service=options.port)
    shown = b"" if options.i420 is None else options.i420.read_bytes()
    factory = Live(options.ahead, options.keys, options.width, options.height, shown)
    if options.password:
        auth = GstRtspServer.RTSPAuth()
        token = GstRtspServer.RTSPToken()
        token.set_string("media.factory.role", "viewer")
        if options.digest:
            auth.set_supported_methods(GstRtsp.RTSPAuthMethod.DIGEST)
            auth.add_digest("viewer", options.password, token)
        else:
            auth.add_basic(GstRtspServer.RTSPAuth.make_basic("viewer", options.password), token)
        server.set_auth(auth)
        permissions = GstRtspServer.RTSPPermissions()
        permissions.add_permission_for_role("viewer", "media.factory.access", True)
        permissions.add_permission_for_role("viewer", "media.factory.construct", True)
        factory.set_permissions(permissions)
    server.get_mount_points().add_factory("/live", factory)
    server.attach(None)
    print("ready", flush=True)
    GLib.MainLoop().run()


if __name__ == "__main__":
    main()
