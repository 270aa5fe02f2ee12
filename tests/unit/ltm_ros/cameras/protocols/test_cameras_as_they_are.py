import gzip
import re
from base64 import b64encode
from typing import Any

import pytest
from scenes.raw_camera import Answer, raw_camera
from scenes.timed_picture import jpeg, scene

from ltm_core.site.source_config import MjpegConfig, RtspConfig, SnapshotConfig, VapixConfig
from ltm_ros.cameras.protocols.credentials import SourceError, UnauthorisedError
from ltm_ros.cameras.protocols.http_pictures import MjpegReader, PartSplitter, SnapshotReader
from ltm_ros.cameras.protocols.picture import CameraImage
from ltm_ros.cameras.protocols.video import RtspReader
from ltm_ros.cameras.ptz.head import settings_of, with_configured_host

JPEG = jpeg(scene(64, 48))
OK = b"HTTP/1.1 200 OK\r\nContent-Type: image/jpeg\r\n"
LENGTH = b"Content-Length: %d\r\n" % len(JPEG)
WHOLE = OK + LENGTH + b"\r\n" + JPEG


def chunk(data: bytes, extension: bytes = b"") -> bytes:
    return b"%x%b\r\n%b\r\n" % (len(data), extension, data)


CHUNKED = OK + b"Transfer-Encoding: chunked\r\n\r\n"
ACCEPTED: dict[str, bytes] = {
    "as it should be": WHOLE,
    "header line without a name": OK + b": no-cache\r\n" + LENGTH + b"\r\n" + JPEG,
    "header line without a colon": OK + b"Pragma no-cache\r\n" + LENGTH + b"\r\n" + JPEG,
    "header name with a space": OK + b"Content-Length : %d\r\n\r\n" % len(JPEG) + JPEG,
    "header name of two words": OK + b"Last Modified: never\r\n" + LENGTH + b"\r\n" + JPEG,
    "control characters in a header": OK + b"X-Name: a\x00\x01b\r\n" + LENGTH + b"\r\n" + JPEG,
    "header with line feeds only": (OK + LENGTH).replace(b"\r\n", b"\n") + b"\n" + JPEG,
    "length too long": OK + b"Content-Length: %d\r\n\r\n" % (len(JPEG) + 500) + JPEG,
    "length of -1": OK + b"Content-Length: -1\r\n\r\n" + JPEG,
    "no length": OK + b"\r\n" + JPEG,
    "HTTP/1.0 without length": OK.replace(b"1.1", b"1.0") + b"\r\n" + JPEG,
    "CRLF before the JPEG": OK + b"Content-Length: %d\r\n\r\n\r\n" % (len(JPEG) + 2) + JPEG,
    "no last chunk": CHUNKED + chunk(JPEG),
    "chunk without its end": CHUNKED + b"%x\r\n" % (len(JPEG) + 9) + JPEG,
    "chunk extension": CHUNKED + chunk(JPEG, b";name=x") + b"0\r\n\r\n",
    "transfer encoding identity": OK + b"Transfer-Encoding: identity\r\n" + LENGTH + b"\r\n" + JPEG,
    "image/jpg": WHOLE.replace(b"image/jpeg", b"image/jpg"),
    "text/html with a JPEG": WHOLE.replace(b"image/jpeg", b"text/html"),
    "gzip": OK + b"Content-Encoding: gzip\r\n\r\n" + gzip.compress(JPEG),
    "zeros after the JPEG": OK + b"\r\n" + JPEG + bytes(700),
}


def snapshot(url: str, **given: Any) -> SnapshotReader:
    return SnapshotReader(SnapshotConfig(kind="snapshot", url=url, **({"timeout": 5.0} | given)), 1 << 20)


@pytest.mark.parametrize("answer", ACCEPTED.values(), ids=ACCEPTED)
def test_snapshots_that_are_accepted(answer: bytes) -> None:
    with raw_camera(answer) as camera:
        picture = snapshot(camera.url()).read()
    assert isinstance(picture, CameraImage)
    assert (picture.jpeg or b"").rstrip(b"\0") == JPEG


def test_a_length_too_long_on_an_open_connection() -> None:
    with raw_camera(ACCEPTED["length too long"], keep=True) as camera:
        assert snapshot(camera.url(), timeout=1.5).read().jpeg == JPEG  # type: ignore[union-attr]


def page(body: str, status: str = "200 OK", more: str = "") -> bytes:
    return f"HTTP/1.1 {status}\r\nContent-Type: text/html\r\n{more}Content-Length: {len(body)}\r\n\r\n{body}".encode()


REJECTED: dict[str, tuple[bytes, str]] = {
    "length too short": (OK + b"Content-Length: 900\r\n\r\n" + JPEG[:900], "Content-Length"),
    "cut within the body": (OK + LENGTH + b"\r\n" + JPEG[:900], "closed the connection"),
    "login page": (page("<!DOCTYPE html><title>Web Login</title>"), 'its login page "Web Login"'),
    "page to sign in": (page("<html><body>Please sign in.</body></html>"), "its login page"),
    "page of a dialog": (page("<html><title>Dialog information</title></html>"), 'a web page "Dialog information"'),
    "page with a password": (page("<html><form><input type='password'></form></html>"), "its login page"),
    "page that redirects": (
        page('<html><meta http-equiv="refresh" content="0; url=/doc/index.asp"></html>'),
        "/doc/index.asp",
    ),
    "script that redirects": (page('<script>window.location.href = "/doc/page.asp"</script>'), "/doc/page.asp"),
    "other page": (page("<html><h1>NVR 3000</h1></html>"), "a web page"),
    "redirect": (page("", "302 Found", "Location: /view/viewer.shtml\r\n"), "/view/viewer.shtml"),
    "redirect to a login": (page("", "302 Found", "Location: /login.htm\r\n"), "its login page /login.htm"),
    "nothing": (OK + b"Content-Length: 0\r\n\r\n", "of 0 bytes"),
    "text": (OK + b"\r\nError: channel 2", "'Error: channel 2'"),
    "base64": (OK + b"\r\n" + b64encode(JPEG), "base64"),
    "stream": (
        b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=x\r\n\r\n--x\r\n\r\n" + JPEG,
        "kind: mjpeg",
    ),
    "not gzip": (OK + b"Content-Encoding: gzip\r\n\r\n" + JPEG, "DecodingError"),
    "busy": (page("", "503 Service Unavailable", "Retry-After: 30\r\n"), "HTTP 503"),
    "two lengths": (OK + LENGTH + b"Content-Length: 7\r\n\r\n" + JPEG, "Content-Length"),
}


@pytest.mark.parametrize(("answer", "named"), REJECTED.values(), ids=REJECTED)
def test_snapshots_that_are_rejected_with_what_the_camera_does(answer: bytes, named: str) -> None:
    with raw_camera(answer) as camera, pytest.raises(SourceError, match=re.escape(named)):
        snapshot(camera.url()).read()


PART = b"Content-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n"
STREAMS: dict[str, tuple[str, bytes, bytes]] = {
    "as it should be": ("boundary=frame", b"--frame\r\n" + PART % len(JPEG), b"\r\n"),
    "quoted": ('boundary="frame"', b"--frame\r\n" + PART % len(JPEG), b"\r\n"),
    "without dashes": ("boundary=frame", b"frame\r\n" + PART % len(JPEG), b"\r\n"),
    "dashes declared": ("boundary=--frame", b"--frame\r\n" + PART % len(JPEG), b"\r\n"),
    "dashes declared and added": ("boundary=--frame", b"----frame\r\nContent-Type: image/jpeg\r\n\r\n", b"\r\n"),
    "with spaces": ('boundary="my frame"', b"--my frame\r\n" + PART % len(JPEG), b"\r\n"),
    "spaces around": ("Boundary = frame ; x=1", b"--frame  \r\n" + PART % len(JPEG), b"\r\n"),
    "in other case": ("BOUNDARY=Frame", b"--fRAME\r\n" + PART % len(JPEG), b"\r\n"),
    "line feeds only": (
        "boundary=frame",
        b"--frame\nContent-Type: image/jpeg\nContent-Length: %d\n\n" % len(JPEG),
        b"\n",
    ),
    "another than declared": ("boundary=frame", b"--ipcamera\r\n" + PART % len(JPEG), b"\r\n"),
    "not declared": ("x=1", b"--frame\r\n" + PART % len(JPEG), b"\r\n"),
    "length too long": ("boundary=frame", b"--frame\r\n" + PART % (len(JPEG) + 300), b"\r\n"),
    "length too short": ("boundary=frame", b"--frame\r\n" + PART % (len(JPEG) - 300), b"\r\n"),
    "length of 0": ("boundary=frame", b"--frame\r\n" + PART % 0, b"\r\n"),
    "length of -1": ("boundary=frame", b"--frame\r\n" + PART % -1, b"\r\n"),
    "no line after the image": ("boundary=frame", b"--frame\r\nContent-Type: image/jpeg\r\n\r\n", b""),
    "no header": ("boundary=frame", b"--frame\r\n\r\n", b"\r\n"),
    "no header and no empty line": ("boundary=frame", b"--frame\r\n", b"\r\n"),
    "header line without a name": ("boundary=frame", b"--frame\r\n: x\r\nnonsense\r\n" + PART % len(JPEG), b"\r\n"),
    "CRLF before the JPEG": ("boundary=frame", b"--frame\r\n" + PART % (len(JPEG) + 2) + b"\r\n", b"\r\n"),
    "CRLF before the JPEG, not counted": ("boundary=frame", b"--frame\r\n" + PART % len(JPEG) + b"\r\n", b"\r\n"),
    "empty lines first": ("boundary=frame", b"\r\n\r\n--frame\r\n" + PART % len(JPEG), b"\r\n"),
}


@pytest.mark.parametrize(("kind", "before", "after"), STREAMS.values(), ids=STREAMS)
def test_streams_that_are_accepted(kind: str, before: bytes, after: bytes) -> None:
    head = f"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; {kind}\r\n\r\n".encode()
    with raw_camera(head + (before + JPEG + after) * 4 + before) as camera:
        reader = MjpegReader(MjpegConfig(kind="mjpeg", url=camera.url(), timeout=5.0), 1 << 20)
        read = [reader.read() for _ in range(4)]
        reader.close()
    assert [getattr(one, "jpeg", None) for one in read] == [JPEG] * 4


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_parts_are_the_same_however_they_arrive(size: int) -> None:
    """Within an image there may be what looks like a boundary; the stated length says that it is none."""
    image = JPEG[:500] + b"\n--x\n" + JPEG[500:]
    stream = (b"--x\r\n" + PART % len(image) + image + b"\r\n") * 3
    parts = PartSplitter(b"x", 1 << 20)
    found = [body for at in range(0, len(stream), size) for _, body in parts.feed(stream[at : at + size])]
    assert found == [image] * 3


def test_a_stream_s_head_is_at_its_host_also_by_ipv6() -> None:
    stream = RtspConfig(kind="rtsp", url="rtsp://[2001:db8::7]:554/live")
    assert settings_of(VapixConfig(kind="vapix"), stream).url == "http://[2001:db8::7]"
    assert (
        with_configured_host("rtsp://10.0.0.1:8554/a?b=1", "http://[2001:db8::7]:80")
        == "rtsp://[2001:db8::7]:8554/a?b=1"
    )
    assert with_configured_host("http://10.0.0.1/a", "https://cam:8443") == "https://cam:8443/a"


# --- authentication

USER, PASSWORD = "viewer", 'tower-%7@ "secret"'
NONCE = 'realm="cam \\"1\\"", nonce="abc=="'
CHALLENGES: dict[str, tuple[str, str]] = {
    "MD5": (f'Digest {NONCE}, qop="auth", algorithm=MD5', "md5"),
    "no algorithm": (f'Digest {NONCE}, qop="auth"', "md5"),
    "empty algorithm": (f'Digest {NONCE}, algorithm=, qop="auth"', "md5"),
    "empty algorithm, quoted": (f'Digest {NONCE}, algorithm="", qop="auth"', "md5"),
    "quoted algorithm": (f'Digest {NONCE}, algorithm="MD5", qop="auth"', "md5"),
    "algorithm in small letters": (f'Digest {NONCE}, algorithm=sha-256, qop="auth"', "sha256"),
    "MD5-sess": (f'Digest {NONCE}, algorithm=MD5-sess, qop="auth"', "md5"),
    "SHA-256": (f'Digest {NONCE}, algorithm=SHA-256, qop="auth"', "sha256"),
    "SHA-512-256": (f'Digest {NONCE}, algorithm=SHA-512-256, qop="auth"', "sha512_256"),
    "auth-int": (f'Digest {NONCE}, qop="auth-int"', "md5"),
    "auth-int and auth": (f'Digest {NONCE}, qop="auth-int, auth", algorithm=SHA-256', "sha256"),
    "auth,auth-int": (f'Digest {NONCE}, qop="auth,auth-int"', "md5"),
    "no qop": (f"Digest {NONCE}", "md5"),
    "empty qop": (f'Digest {NONCE}, qop=""', "md5"),
    "opaque": (f'Digest {NONCE}, opaque="x,y", qop=auth', "md5"),
    "without commas and with spaces": ('DIGEST realm = "cam" , nonce = "abc==" , qop = "auth"', "md5"),
    "basic": ('Basic realm="x"', "basic"),
    "basic and digest in one line": (f'Basic realm="a, b", Digest {NONCE}, qop="auth"', "md5"),
    "digest and basic in one line": (f'Digest {NONCE}, qop="auth", Basic realm="x"', "md5"),
    "two digests in one line": (
        f'Digest {NONCE}, qop="auth", algorithm=MD5, Digest {NONCE}, qop="auth", algorithm=SHA-256',
        "sha256",
    ),
    "an unknown algorithm beside": (f"Digest {NONCE}, algorithm=X, Digest {NONCE}, algorithm=MD5", "md5"),
    "bearer beside": ('Bearer realm="x", Basic realm="x"', "basic"),
}


def right(head: str, challenge: str, hashed: str) -> bool:
    """Whether a request answers its challenge, computed by the words of RFC 7616."""
    import hashlib

    line = next((one for one in head.split("\r\n") if one.lower().startswith("authorization:")), "").partition(" ")[2]
    if hashed == "basic":
        return line == f"Basic {b64encode(f'{USER}:{PASSWORD}'.encode()).decode()}"
    given = {name: (quoted or bare).replace('\\"', '"') for name, quoted, bare in re.findall(
        r'(\w+)=(?:"((?:[^"\\]|\\.)*)"|([^\s,]+))', line)}  # fmt: skip

    def h(text: str) -> str:
        return hashlib.new(hashed, text.encode()).hexdigest()

    if not line.startswith("Digest ") or given["nonce"] != "abc==":
        return False
    first = h(f"{USER}:{given['realm']}:{PASSWORD}")
    if "-sess" in challenge:
        first = h(f"{first}:abc==:{given['cnonce']}")
    method, uri = head.split()[:2]
    second = f"{method}:{uri}" + (f":{h('')}" if given.get("qop") == "auth-int" else "")
    middle = f"abc==:{given['nc']}:{given['cnonce']}:{given['qop']}" if "qop" in given else "abc=="
    opaque = given.get("opaque") == ("x,y" if "opaque" in challenge else None)
    return opaque and given["uri"] == uri and given["response"] == h(f"{first}:{middle}:{h(second)}")


@pytest.fixture
def login(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.setenv("NORTH", PASSWORD)
    return {"user": USER, "password": {"environment": "NORTH"}}


def asked(challenge: str, hashed: str) -> Answer:
    refused = f"HTTP/1.1 401 Unauthorized\r\nWWW-Authenticate: {challenge}\r\nContent-Length: 0\r\n\r\n".encode()
    return lambda head: WHOLE if right(head, challenge, hashed) else refused


@pytest.mark.parametrize(("challenge", "hashed"), CHALLENGES.values(), ids=CHALLENGES)
def test_challenges(login: dict[str, Any], challenge: str, hashed: str) -> None:
    with raw_camera(asked(challenge, hashed), keep=True) as camera:
        reader = snapshot(camera.url("/picture?channel=1&x=%20a"), **login)
        for _ in range(2):
            assert getattr(reader.read(), "jpeg", None) == JPEG
        reader.close()
    assert len(camera.heads) == 3, "the second request needs no new challenge"
    if hashed != "basic" and "qop" in challenge and 'qop=""' not in challenge:
        assert ["nc=00000001" in camera.heads[1], "nc=00000002" in camera.heads[2]] == [True, True]


def test_a_stale_nonce_is_replaced(login: dict[str, Any]) -> None:
    stale = b'HTTP/1.1 401 x\r\nWWW-Authenticate: Digest realm="x", nonce="%b", stale=%b\r\nContent-Length: 0\r\n\r\n'
    with raw_camera(stale % (b"1", b"false"), WHOLE, stale % (b"2", b"TRUE"), WHOLE, keep=True) as camera:
        reader = snapshot(camera.url(), **login)
        assert [getattr(reader.read(), "jpeg", None) for _ in range(2)] == [JPEG] * 2
        reader.close()
    assert ['nonce="2"' in head for head in camera.heads] == [False, False, False, True]


@pytest.mark.parametrize(
    "challenge", [f"Digest {NONCE}, algorithm=SHA3-512", "Negotiate", 'Digest realm="x"', f"Digest {NONCE}, qop=conf"]
)
def test_what_cannot_be_answered_is_named_and_sends_no_password(login: dict[str, Any], challenge: str) -> None:
    answer = asked(challenge, "md5")
    with raw_camera(answer, keep=True) as camera, pytest.raises(UnauthorisedError, match=challenge.split()[0].lower()):
        snapshot(camera.url(), **login).read()
    assert len(camera.heads) == 1


# --- RTSP

SDP = "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=x\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\n"
MD5, SHA = (f'WWW-Authenticate: Digest realm="x", nonce="abc", algorithm={name}' for name in ("MD5", "SHA-256"))
RTSP: dict[str, tuple[dict[str, str], type[SourceError], str]] = {
    "SHA-256": ({"DESCRIBE": f"401 Unauthorized\r\n{SHA}"}, UnauthorisedError, "digest SHA-256"),
    "MD5, then SHA-256": ({"DESCRIBE": f"401 Unauthorized\r\n{MD5}\r\n{SHA}"}, UnauthorisedError, "digest SHA-256"),
    "wrong password": ({"DESCRIBE": f"401 Unauthorized\r\n{MD5}"}, UnauthorisedError, "rejected user viewer"),
    "not found": ({"DESCRIBE": "404 Not Found"}, SourceError, "404 Not Found"),
    "no session": ({"DESCRIBE": "454 Session Not Found"}, SourceError, "454 Session Not Found"),
    "busy": ({"DESCRIBE": "503 Service Unavailable"}, SourceError, "503"),
    "redirect": ({"DESCRIBE": "302 Found\r\nLocation: rtsp://127.0.0.1:1/x"}, SourceError, "refused"),
    "bandwidth": ({"SETUP": "453 Not Enough Bandwidth"}, SourceError, "453"),
    "transport": ({"SETUP": "461 Unsupported Transport"}, SourceError, "transport: udp"),
}


@pytest.mark.parametrize(("answers", "error", "named"), RTSP.values(), ids=RTSP)
def test_what_a_stream_answers_is_named(
    login: dict[str, Any], answers: dict[str, str], error: type[SourceError], named: str
) -> None:
    pytest.importorskip("av", reason="the extra rtsp is not installed")

    def answer(head: str) -> bytes:
        method, count = head.split()[0], re.findall(r"(?i)cseq: *(\d+)", head)[0]
        body = SDP if method == "DESCRIBE" and method not in answers else ""
        kind = f"Content-Type: application/sdp\r\nContent-Length: {len(body)}\r\n" if body else ""
        return f"RTSP/1.0 {answers.get(method, '200 OK')}\r\nCSeq: {count}\r\n{kind}\r\n{body}".encode()

    with raw_camera(answer, keep=True) as camera, pytest.raises(error, match=re.escape(named)) as caught:
        RtspReader(RtspConfig(kind="rtsp", url=camera.url("/live", "rtsp"), timeout=5.0, **login))
    assert (type(caught.value), "secret" in str(caught.value)) == (error, False)
