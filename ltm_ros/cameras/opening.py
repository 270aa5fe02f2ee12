"""Connects to a camera as its site file says."""

from __future__ import annotations

from ltm_core.site.source_config import (
    CameraListConfig,
    FolderConfig,
    MjpegConfig,
    RtspConfig,
    SnapshotConfig,
    SourceConfig,
    V4l2Config,
)
from ltm_ros.cameras.protocols.camera_list import CameraListReader
from ltm_ros.cameras.protocols.folder import FolderReader
from ltm_ros.cameras.protocols.http_pictures import MjpegReader, SnapshotReader
from ltm_ros.cameras.protocols.picture import CameraReader
from ltm_ros.cameras.protocols.video import RtspReader, V4l2Reader
from ltm_ros.runtime.clocks import Clock


def open_reader(config: SourceConfig, most_bytes: int, clock: Clock) -> CameraReader:
    """`most_bytes`: of a picture. Raises SourceError."""
    match config:
        case SnapshotConfig():
            return SnapshotReader(config, most_bytes)
        case MjpegConfig():
            return MjpegReader(config, most_bytes)
        case RtspConfig():
            return RtspReader(config)
        case V4l2Config():
            return V4l2Reader(config)
        case FolderConfig():
            return FolderReader(config, most_bytes, clock)
        case CameraListConfig():
            return CameraListReader(config, most_bytes)
