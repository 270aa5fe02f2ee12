"""What a check has found: one thing that was looked at, its verdict, and the remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ltm_core.base.errors import LtmError


class SiteVerdict(StrEnum):
    OK = "ok"
    DOUBTFUL = "doubtful"
    """It runs, but may not be what is meant."""
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
