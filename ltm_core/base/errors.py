"""Exceptions for bad input (`LtmError` and its children); any other exception is a bug and ends the process."""


class LtmError(Exception):
    """Bad input. The message holds the value, the place it came from and what would be right."""


class ConfigError(LtmError):
    """A site, scenario or parameter file that cannot be taken."""


class RasterError(LtmError):
    """A DEM or fuel raster that cannot be taken."""


class CameraError(LtmError):
    """A camera calibration that cannot be taken."""


class PoseError(LtmError):
    """A camera pose that cannot be taken."""


class ImageError(LtmError):
    """An image, depth image or label image that cannot be taken."""


class RegionError(LtmError):
    """A pixel or region of a picture that cannot be located on the map."""


class MessageError(LtmError):
    """A message whose fields contradict each other or the contract of its topic."""


class ModelError(LtmError):
    """A network or its manifest that cannot be taken."""


class RecordingError(LtmError):
    """A bag or photo folder that cannot be read or written."""


class StoreError(LtmError):
    """A store that cannot be read or written just now: disk full, read-only, in use by another process."""


class ArchiveError(LtmError):
    """An archive of recordings that cannot be worked again as asked."""
