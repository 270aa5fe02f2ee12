"""Provenance of an exported fuel map: its site and date, the share that was seen, and its sources."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version

from ltm_core.base.number_text import percent
from ltm_core.fuel.codes import FuelSystem
from ltm_core.fuel.export.landscape import LANDSCAPE_BANDS, LANDSCAPE_UNITS
from ltm_core.surface.confirmed_surface import SurfaceVersion

NOTHING_SEEN = "nothing seen"
WITHOUT_DATES = "unknown date"


@dataclass(frozen=True)
class Provenance:
    """`as_of`: ISO 8601 UTC of the newest frame that had a say, or of the moment asked for; NOTHING_SEEN where no frame
    had, WITHOUT_DATES of a map that does not tell. `seen`, `changed`: shares of the cells with a code; None where it is
    not known. `prior_version`: LANDFIRE's where its name tells it, and a digest of the codes on the fuel grid.
    `terrain`, `surface`: notes about heights, empty for the site's own."""

    site: str
    as_of: str
    cells: int
    seen: float | None
    changed: float
    prior: str
    prior_version: str
    climate: str
    system: FuelSystem
    software: str
    terrain: str = ""
    surface: str = ""
    labels: str = ""
    """What the labels that vote were measured on; empty: not known."""
    own_fbfm13: str = ""
    """What was kept of the prior's FBFM13 map (`PriorConfig.own_fbfm13`); empty: nothing."""
    accuracy: str = ""
    """Accuracy of the map as assessed with `ltm assess`; empty: not assessed."""

    def tags(self) -> dict[str, str]:
        """Return the tags of a GeoTIFF: standard TIFF tags and our own."""
        tags = {
            "site": self.site,
            "as_of": self.as_of,
            "cells_with_code": str(self.cells),
            "seen_share": "unknown" if self.seen is None else f"{self.seen:.4f}",
            "changed_share": f"{self.changed:.4f}",
            "prior": self.prior,
            "prior_version": self.prior_version,
            "fuel_region": self.climate,
            "fuel_system": self.system.value,
            "software": self.software,
            "TIFFTAG_SOFTWARE": self.software,
            "TIFFTAG_IMAGEDESCRIPTION": self.line(),
        }
        more = ("terrain", "surface", "labels", "own_fbfm13", "accuracy")
        tags |= {name: text for name in more if (text := getattr(self, name))}
        if (moment := self.moment()) is not None:
            tags["TIFFTAG_DATETIME"] = moment.strftime("%Y:%m:%d %H:%M:%S")
        return tags

    def line(self) -> str:
        """Return one line for formats with a text field."""
        seen = "unknown" if self.seen is None else f"{self.seen:.1%}"
        parts = [
            f"fuel map of {self.site}",
            f"as of {self.as_of}",
            f"seen {seen}, changed {self.changed:.1%} of {self.cells} cells",
            f"prior {self.prior} ({self.prior_version})",
            f"{self.system.value}, region {self.climate}",
            f"labels {self.labels}" if self.labels else "",
            self.software,
        ]
        return "; ".join(filter(None, [*parts, self.terrain, self.surface, self.accuracy]))

    def heading(self, crs: str) -> str:
        """Return the heading of a picture: site, CRS, date, and the share of the cells that cameras have seen."""
        moment = self.moment()
        dated = self.as_of if moment is None else f"as of {moment:%Y-%m-%d %H:%M} UTC"
        seen = "" if self.seen is None else f" Cameras have seen {percent(self.seen)} of the cells."
        return f"Fuel map of {self.site} ({crs}), {dated}.{seen}"

    def moment(self) -> datetime | None:
        """Return the time; None if no frame contributed, or none has a date."""
        return None if self.as_of in (NOTHING_SEEN, WITHOUT_DATES) else datetime.fromisoformat(self.as_of)


def landscape_units() -> dict[str, str]:
    """Return the unit of each band of a landscape, as tags."""
    return {f"unit_{name}": unit for name, unit in zip(LANDSCAPE_BANDS, LANDSCAPE_UNITS, strict=True)}


def surface_note(surface: SurfaceVersion) -> str:
    """Return a note about heights that views have confirmed."""
    return (
        f"heights of surface {surface.version}, confirmed by views as of {iso_moment(surface.as_of_ns)}: "
        f"{surface.changed_share:.1%} of {surface.seen} terrain cells seen have changed"
    )


def iso_moment(stamp_ns: int) -> str:
    """Return the time in ISO 8601, UTC, to the second."""
    return datetime.fromtimestamp(stamp_ns // 10**9, UTC).isoformat()


def software() -> str:
    """This program and its version."""
    try:
        return f"ltm {version('ltm')}"
    except PackageNotFoundError:
        return "ltm, not installed"


def landfire_version(name: str) -> str:
    """Return LANDFIRE's release by a file's name: LC22_F40_230.tif is of 2022, version 2.3.0; empty if unknown."""
    found = re.search(r"LC(\d\d)_[A-Za-z0-9]+_(\d)(\d)(\d)(?!\d)", name)
    return "" if found is None else f"LANDFIRE 20{found[1]}, version {found[2]}.{found[3]}.{found[4]}"


def as_rows(tags: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return our own tags, without TIFF's, for formats with a table."""
    return [(name, value) for name, value in tags.items() if not name.startswith("TIFFTAG_")]
