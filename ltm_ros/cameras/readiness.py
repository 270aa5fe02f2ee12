"""What a camera's source will lack on this machine, found before it is asked for the first time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from importlib.util import find_spec

from ltm_core.site.source_config import (
    FolderConfig,
    HttpSettings,
    NetworkSettings,
    RtspConfig,
    SourceConfig,
    V4l2Config,
)
from ltm_core.storage.disk_io import is_file, is_folder, is_there
from ltm_ros.cameras.protocols.credentials import read_secret
from ltm_ros.cameras.protocols.errors import UnauthorisedError


def doubts_of(source: SourceConfig) -> Iterator[str]:
    """Each with its remedy. A service may have what a shell has not, so none of them is certain."""
    if isinstance(source, NetworkSettings) and source.password is not None:
        try:
            read_secret(source.password)
        except UnauthorisedError as error:
            yield str(error)
    if isinstance(source, RtspConfig | V4l2Config) and find_spec("av") is None:
        yield 'video needs PyAV: pip install "ltm[rtsp]"'
    if isinstance(source, V4l2Config):
        if not is_there(source.device):
            yield f"{source.device} is not there: plug the camera in, or mend device (ls /dev/v4l/by-id)"
        elif not os.access(source.device, os.R_OK | os.W_OK):
            yield f"{source.device} may not be read: add the user to the group video"
    if isinstance(source, HttpSettings) and source.ca is not None and not is_file(source.ca):
        yield f"ca {source.ca} is not there"
    if isinstance(source, FolderConfig) and not is_folder(source.path):
        yield f"{source.path} is no folder: make it, or mend path"
