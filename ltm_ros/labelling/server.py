"""Serves the labelling page on this machine to whoever has its link."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from importlib.resources import files

from ltm_core.base.errors import LtmError
from ltm_ros.labelling.session import LabelSession
from ltm_ros.runtime.web_server import Route, WebResponse, WebServer

MOST_BYTES = 8 << 20
"""Size limit of a request."""
REQUEST_S = 600.0
"""Time limit of a request: on a slow machine the network needs a while for a large photo."""


class LabelServer(WebServer):
    """Serve a folder's photos on the loopback interface; its `url` holds a random token."""

    def __init__(self, session: LabelSession, port: int = 0) -> None:
        root = f"/{secrets.token_urlsafe(24)}/"
        routes = {f"GET {root}": _page, f"GET {root}photos": _json(session.overview)}
        for number in range(len(session)):
            routes[f"GET {root}photo/{number}"] = partial(_photo, session, number)
            routes[f"GET {root}areas/{number}"] = _json(partial(session.areas, number))
            routes[f"GET {root}suggested/{number}"] = _json(partial(session.suggested, number))
            routes[f"PUT {root}areas/{number}"] = partial(_save, session, number)
        super().__init__(routes, port=port, body_bytes=MOST_BYTES, request_s=REQUEST_S)
        self.url += root


def _json(make: Callable[[], object]) -> Route:
    return lambda _: _checked(lambda: WebResponse.json(make()))


def _photo(session: LabelSession, number: int, _: bytes) -> WebResponse:
    return _checked(lambda: WebResponse(session.photo(number), "image/jpeg"))


def _save(session: LabelSession, number: int, body: bytes) -> WebResponse:
    try:
        content: object = json.loads(body)
    except (ValueError, RecursionError) as error:
        return WebResponse.error(HTTPStatus.BAD_REQUEST, f"not JSON ({error})")
    return _checked(lambda: WebResponse.json(session.save(number, content)))


def _checked(respond: Callable[[], WebResponse]) -> WebResponse:
    try:
        return respond()
    except LtmError as error:
        return WebResponse.error(HTTPStatus.BAD_REQUEST, str(error))
    except OSError as error:
        return WebResponse.error(HTTPStatus.INSUFFICIENT_STORAGE, f"cannot be written: {error.strerror}")


def _page(_: bytes) -> WebResponse:
    nonce = secrets.token_urlsafe(16)
    page = files("ltm_ros.labelling").joinpath("page.html").read_text("utf-8").replace("NONCE", nonce)
    policy = (
        f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return WebResponse(page.encode(), "text/html; charset=utf-8", policy=policy)
