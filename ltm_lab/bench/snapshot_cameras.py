"""HTTP cameras of the sources' bench: `python -m ltm_lab.bench.snapshot_cameras PHOTO AHEAD` serves the JPEG of that
file at any path, and prints its port. Each answer has a comment that tells when it was taken, in true epoch seconds;
`AHEAD`: seconds by which the cameras' clock is wrong. Ends with its stdin.
"""

from __future__ import annotations

import sys
import threading
import time
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

MARK = b"taken="
_COMMENT = b"\xff\xfe"


def with_time(jpeg: bytes, moment: float) -> bytes:
    """With a comment segment after the begin. Source: ITU-T T.81, B.2.4.5."""
    text = MARK + f"{moment:.6f}".encode()
    return jpeg[:2] + _COMMENT + (len(text) + 2).to_bytes(2, "big") + text + jpeg[2:]


def time_in(jpeg: bytes) -> float:
    """What `with_time` wrote."""
    length = int.from_bytes(jpeg[4:6], "big")
    return float(jpeg[6 : 4 + length].removeprefix(MARK))


def main() -> None:
    photo, ahead = Path(sys.argv[1]).read_bytes(), float(sys.argv[2])

    class Camera(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        disable_nagle_algorithm = True

        def do_GET(self) -> None:
            moment = time.time()
            body = with_time(photo, moment)
            self.send_response_only(200)
            self.send_header("Date", formatdate(moment + ahead, usegmt=True))
            self.send_header("Last-Modified", formatdate(moment + ahead, usegmt=True))
            self.send_header("Content-Type", "image/jpeg")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    server = ThreadingHTTPServer(("127.0.0.1", 0), Camera)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    print(server.server_address[1], flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main()
