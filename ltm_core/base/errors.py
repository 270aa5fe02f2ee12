"""Define the exceptions for invalid input, and the findings of checks."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


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
    """A pixel or region of an image that cannot be located on the map."""


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


class SiteVerdict(StrEnum):
    OK = "ok"
    DOUBTFUL = "doubtful"
    """It runs, but the setting may not be intended."""
    WRONG = "wrong"
    """It cannot work."""


@dataclass(frozen=True)
class SiteFinding:
    """One thing that was looked at. `said`: what was found, and the remedy where something is amiss; one line."""

    area: str
    name: str
    verdict: SiteVerdict
    said: str

    @classmethod
    def of(cls, area: str, name: str, error: LtmError | str, verdict: SiteVerdict = SiteVerdict.WRONG) -> SiteFinding:
        """Of an error or a doubt; its lines become one."""
        return cls(area, name, verdict, "; ".join(line.strip() for line in str(error).splitlines()).replace(":;", ":"))
