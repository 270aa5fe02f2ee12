"""Define the exceptions for invalid input, and the findings of checks."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum


class LtmError(Exception):
    """Report invalid input. The message has the value, the place it came from and the remedy."""


class ConfigError(LtmError):
    """A site, scenario or parameter file is invalid."""


class RasterError(LtmError):
    """A DEM or fuel raster is invalid."""


class CameraError(LtmError):
    """A camera calibration is invalid."""


class PoseError(LtmError):
    """A camera pose is invalid."""


class ImageError(LtmError):
    """An image, depth image or label image is invalid."""


class RegionError(LtmError):
    """A pixel or region of an image cannot be located on the map."""


class MessageError(LtmError):
    """The fields of a message contradict each other or the contract of its topic."""


class ModelError(LtmError):
    """A network or its manifest is invalid."""


class RecordingError(LtmError):
    """A bag or photo folder cannot be read or written."""


class StoreError(LtmError):
    """A store cannot be read or written at present: disk full, read-only, or in use by another process."""


class ArchiveError(LtmError):
    """An archive of recordings cannot be reprocessed as requested."""


class SiteVerdict(StrEnum):
    OK = "ok"
    DOUBTFUL = "doubtful"
    """It runs, but the setting may not be intended."""
    WRONG = "wrong"
    """It cannot work."""


@dataclass(frozen=True)
class SiteFinding:
    """Result of one check of a site. `said`: the result, and the remedy if there is a problem; one line."""

    area: str
    name: str
    verdict: SiteVerdict
    said: str

    @classmethod
    def of(cls, area: str, name: str, error: LtmError | str, verdict: SiteVerdict = SiteVerdict.WRONG) -> "SiteFinding":
        """Return the finding of an error or a warning; its lines are joined into one."""
        return cls(area, name, verdict, "; ".join(line.strip() for line in str(error).splitlines()).replace(":;", ":"))


class Findings(list[SiteFinding]):
    """The findings of checks, in order."""

    def ok(self, area: str, name: str, said: str) -> None:
        self.append(SiteFinding(area, name, SiteVerdict.OK, said))

    def doubt(self, area: str, name: str, said: str) -> None:
        self.append(SiteFinding.of(area, name, said, SiteVerdict.DOUBTFUL))

    def weighed(self, area: str, name: str, found: str, doubts: list[str]) -> None:
        """Add what was found, doubtful if there are doubts, which follow it."""
        (self.doubt if doubts else self.ok)(area, name, "; ".join([found, *doubts]))

    @contextmanager
    def errors(self, area: str, name: str) -> Iterator[None]:
        """Turn an LtmError in the block into a finding."""
        try:
            yield
        except LtmError as error:
            self.append(SiteFinding.of(area, name, error))
