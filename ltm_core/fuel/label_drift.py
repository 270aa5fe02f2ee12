"""Watch whether labels of unchanged cells still agree with earlier ones, by a control chart of weekly shares.

A week's share is the mean, over the frames of a camera, of the share of pixels in unchanged cells whose label is the
cell's life form. Season, light and views move it, so its variance is that between all weeks until now. The chart is an
EWMA (Roberts, Technometrics 1, 1959) whose limits keep the full standard deviation of a week, because neighbouring
weeks are alike. Centre and deviation follow a slow seasonal cycle, which therefore stays within the limits."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import Field

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.life_form import FORMS, label_forms
from ltm_core.fuel.votes import CellVotes
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.areas import replace_file
from ltm_core.vision.labels import LabelSet

WEEK_NS: Final = 7 * 86400 * 10**9
LIMIT: Final = 3.0
"""Standard deviations below the mean of earlier weeks at which labels are reported as drifting."""
FIRST_WEEKS: Final = 12
"""Weeks before the chart judges."""
_WEIGHT = 0.5
"""Weight of the newest week in the moving average."""
_LEAST_SIGMA = 0.04
"""Minimum standard deviation of a week: a fall by less than 12 points is never reported."""
_KEPT_WEEKS = 104
_REFERENCE_WEEKS = 8
"""Weeks for which one reference is used, so that cells that drifting labels turn are still compared."""
_MOST_CELLS = 500
"""Cells of a frame that are compared, evenly chosen: a week has hundreds of frames."""
_LEAST_PIXELS = 200
"""Pixels in unchanged cells below which a frame says nothing."""


class CameraDrift(StrictModel):
    """The chart of one camera. `week`: number of the current week since 1970; `frames`, `total`: its frames, and the
    sum of their shares; `shares`: of the closed weeks, oldest first; `model`: network of these labels."""

    week: int = 0
    frames: int = Field(0, ge=0)
    total: float = 0.0
    shares: tuple[float, ...] = Field((), max_length=_KEPT_WEEKS)
    model: str = ""


class _State(StrictModel):
    cameras: dict[str, CameraDrift] = Field(default_factory=dict)


def drift_sigmas(shares: Sequence[float]) -> float:
    """Return how many standard deviations the moving average of weekly shares is above the mean of the weeks before;
    negative: below. 0 during the first weeks. A week beyond the limit counts in mean and deviation as one at it."""
    counted: list[float] = []
    average, sigmas = shares[0] if shares else 0.0, 0.0
    for share in shares:
        average += _WEIGHT * (share - average)
        if len(counted) >= FIRST_WEEKS:
            mean, sigma = float(np.mean(counted)), max(float(np.std(counted, ddof=1)), _LEAST_SIGMA)
            sigmas = (average - mean) / sigma
            share = max(share, mean - LIMIT * sigma)
        counted.append(share)
    return sigmas


class LabelDrift:
    """The charts of a site's cameras, kept in `file` (None: only in memory). A camera whose network changes starts
    again. `fresh`: ignore what the file holds. Raises ConfigError for an invalid file."""

    def __init__(self, labels: LabelSet, file: Path | None, fresh: bool = False) -> None:
        self._file = file
        kept = file is not None and not fresh and file.exists()
        self._charts = load_yaml(file, _State).cameras if file is not None and kept else {}
        forms = label_forms(labels)
        self._columns = np.full(256, -1, np.int64)
        """Column of the votes by life form; -1: no label has it."""
        self._columns[forms[forms >= 0] + 1] = np.flatnonzero(forms >= 0)
        self._covers = np.flatnonzero((forms >= 0) & (forms < FORMS))
        self._reference: UInt8Array | None = None
        self._reference_week = 0

    def wants_reference(self, stamp_ns: int) -> bool:
        """Return whether `set_reference` must come before a frame of this time."""
        return self._reference is None or stamp_ns // WEEK_NS >= self._reference_week + _REFERENCE_WEEKS

    def set_reference(self, life_form: UInt8Array, unchanged: np.ndarray, stamp_ns: int) -> None:
        """Take the life forms of the unchanged cells, (H, W) each, for the next weeks."""
        self._reference = np.where(unchanged, life_form, 0).astype(np.uint8)
        self._reference_week = stamp_ns // WEEK_NS

    def take(self, votes: CellVotes, model: str = "") -> bool:
        """Count a frame; return whether it began a new week, so that `sigmas` has changed."""
        if self._reference is None or len(votes) == 0:
            return False
        every = slice(None, None, 1 + len(votes) // _MOST_CELLS)
        columns = self._columns[self._reference[votes.rows[every], votes.cols[every]]]
        cells = np.flatnonzero(columns >= 0)
        counts = votes.counts[every][cells]
        pixels = int(counts[:, self._covers].sum())
        if pixels < _LEAST_PIXELS:
            return False
        share = float(counts[np.arange(len(cells)), columns[cells]].sum()) / pixels
        week, now = votes.stamp_ns // WEEK_NS, self._charts.get(votes.source)
        if now is None or now.model != model:
            now = CameraDrift(week=week, model=model)
        if week < now.week:  # late: its week is closed
            return False
        closed = week > now.week
        if closed:
            shares = (*now.shares, *([now.total / now.frames] if now.frames else []))
            now = CameraDrift(week=week, shares=shares[-_KEPT_WEEKS:], model=model)
        update = {"frames": now.frames + 1, "total": now.total + share}
        self._charts[votes.source] = now.model_copy(update=update)
        return closed

    def weeks(self) -> dict[str, tuple[float, ...]]:
        """Return the shares of the closed weeks by camera, oldest first."""
        return {camera: chart.shares for camera, chart in self._charts.items() if chart.shares}

    def problem(self) -> str:
        """Return which cameras' labels drift, in words; empty: none."""
        found = []
        for camera, chart in sorted(self._charts.items()):
            if drift_sigmas(chart.shares) < -LIMIT:
                day = datetime.fromtimestamp(chart.week * (WEEK_NS // 10**9), UTC)
                last = f"{chart.shares[-1]:.0%} agree in the last week before {day:%Y-%m-%d}"
                found.append(f"{camera}: {last}, usual {float(np.median(chart.shares)):.0%}")
        advice = "clean the lens, check the pose, assess the map"
        return f"labels of unchanged cells drift ({'; '.join(found)}): {advice}" if found else ""

    def save(self) -> None:
        """Write the charts. Raises ConfigError if that fails."""
        try:
            if self._file is not None:
                replace_file(self._file, _State(cameras=self._charts).model_dump_json().encode())
        except OSError as error:
            raise ConfigError(f"{self._file}: cannot be written ({error.strerror}); check the disk") from error
