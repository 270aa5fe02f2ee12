"""Find a recorded run with its truth, which a simulated site may have of several dates."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from ltm_core.base.errors import RecordingError
from ltm_core.site.site_io import load_site
from ltm_ros.recordings.recorded_run import FUEL_TRUTH, Recorded, site_of


@dataclass(frozen=True)
class DatedRun(Recorded):
    """A recorded run; `surfaces`: rasters of the true surface at its date and at the previous one, if any."""

    surfaces: tuple[Path | None, Path | None] = (None, None)

    @classmethod
    def find(cls, bag: Path, site: Path | None = None, truth: Path | None = None, date: str | None = None) -> Self:
        """Find the site, as given or as `site_of`, and its truth: below the site's folder, in `truth/DATE/` if it has
        several dates. Raises RecordingError without a site or date, ConfigError for an invalid site."""
        path = site or site_of(bag)
        folder = truth or path.resolve().parent
        dates = sorted(p.name for p in (folder / "truth").glob("*") if p.is_dir())
        if date is None and len(dates) > 1:
            raise RecordingError(f"{folder} contains the truth of {', '.join(dates)}: give the bag's date with --date")
        if date is not None and date not in dates:
            raise RecordingError(f"{folder} contains no truth of {date!r}; it has {', '.join(dates) or 'none'}")
        rasters = [folder / FUEL_TRUTH]
        surfaces: list[Path] = []
        if date is not None:
            rasters.insert(0, folder / "truth" / date / "life_form.tif")
            earlier = [path.stem.split("_")[1] for path in (folder / "truth").glob(f"change_*_{date}.tif")]
            surfaces = [folder / "truth" / name / "surface.tif" for name in (date, *earlier[:1])]
        now, before = [*(file if file.is_file() else None for file in surfaces), None, None][:2]
        forms = next((file for file in rasters if file.is_file()), None)
        return cls(bag, path, load_site(path), folder, forms, (now, before))
