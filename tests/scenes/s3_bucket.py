"""A bucket on an S3 server of the test's own (moto), for whoever writes to `s3://`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest


def _nobody(request: str) -> bool:
    return False


@contextmanager
def empty_bucket(name: str, refuses: Callable[[str], bool] = _nobody) -> Iterator[str]:
    """The address of an empty bucket, which the environment's `AWS_*` lead to meanwhile; skips without s3fs or moto.

    `refuses`: whether a request, such as `GET /name/file`, is answered with 503, as of a store that has too many.
    """
    s3fs = pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    made = "moto.moto_server.threaded_moto_server.DomainDispatcherApplication"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(made, lambda backend: _Refusing(DomainDispatcherApplication(backend), refuses))
        from moto.moto_server.werkzeug_app import DomainDispatcherApplication

        server.start()
    host, port = server.get_host_and_port()
    given = {"ENDPOINT_URL": f"http://{host}:{port}", "ACCESS_KEY_ID": "test", "SECRET_ACCESS_KEY": "test"}
    with pytest.MonkeyPatch.context() as environment:
        for variable, value in (given | {"DEFAULT_REGION": "us-east-1"}).items():
            environment.setenv(f"AWS_{variable}", value)
        s3fs.S3FileSystem.clear_instance_cache()
        s3fs.S3FileSystem().makedirs(name, exist_ok=True)
        yield f"s3://{name}"
        s3fs.S3FileSystem.clear_instance_cache()
    server.stop()


class _Refusing:
    """A server's application, of which some requests never hear."""

    def __init__(self, application: Any, refuses: Callable[[str], bool]) -> None:
        self._application, self._refuses = application, refuses

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Any:
        if self._refuses(f"{environ['REQUEST_METHOD']} {environ['PATH_INFO']}"):
            start_response("503 Slow Down", [("Content-Type", "application/xml")])
            return [b"<Error><Code>SlowDown</Code><Message>Please reduce your request rate.</Message></Error>"]
        return self._application(environ, start_response)
