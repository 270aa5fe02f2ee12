"""A bucket on an S3 server of the test's own (moto), for whoever writes to `s3://`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def empty_bucket(name: str) -> Iterator[str]:
    """The address of an empty bucket, which the environment's `AWS_*` lead to meanwhile; skips without s3fs or moto."""
    s3fs = pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer("127.0.0.1", 0, verbose=False)
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
