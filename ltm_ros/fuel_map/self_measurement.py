"""Measure a site's labels from its own votes while the fuel map runs, and watch whether they drift."""

from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.fuel.label_drift import LabelDrift, drift_sigmas
from ltm_core.fuel.label_errors import ReliabilityRecord, record_of, write_record
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_fuel import measured_errors
from ltm_core.site.networks import label_model, unmeasured_labels
from ltm_core.site.site import Site
from ltm_core.vision.labels import LabelSet
from ltm_ros.fuel_map.layers import ShownLayers
from ltm_ros.runtime.health import Health

MEASURED_AT: Final = (12, 24, 48)
"""Numbers of views at which labels are measured; the last result is final. 48 views take 15 MB until then."""
DRIFT_FILE: Final = "label_drift.json"
"""Charts of label drift in the folder of the fuel map."""
_CHART_WEEKS: Final = 52
"""Weeks that the status page draws."""
_SECTORS: Final = 24
"""Number of viewing directions per camera that count as different views: one for 15 degrees."""


class SelfMeasurement:
    """Collects one frame of each view (camera, viewing direction, period of `look_s`) and measures the labels by them,
    in a thread of its own. The result depends on the frames alone."""

    def __init__(self, site: Site, geometry: GridGeometry, labels: LabelSet, folder: Path | None) -> None:
        """`folder`: of the fuel map, in which the record is written; None: it is not kept. Raises ModelError,
        ConfigError as `unmeasured_labels`."""
        self._site, self._geometry, self._labels, self._folder = site, geometry, labels, folder
        self._digest = None if site.fuel.prior is None else unmeasured_labels(site)
        self._views: dict[tuple[str, int, int], CellVotes] = {}
        self._pending: list[CellVotes] = []
        self._waiting = list(MEASURED_AT)
        self._running: Future[ReliabilityRecord] | None = None
        self.failure = ""
        """Reason why the last attempt gave no record; empty: there is none."""

    @property
    def wanted(self) -> bool:
        """Return whether more frames are wanted."""
        return self._digest is not None and (bool(self._waiting) or self._running is not None)

    def take(self, votes: CellVotes) -> None:
        """Take a counted frame; ignored if none is wanted."""
        if not self.wanted or votes.visibility is None:
            return
        if self._running is not None:
            self._pending.append(votes)
            return
        look, bearing = round(self._site.fuel.fusion.look_s * 1e9), votes.visibility.bearing
        mean = np.arctan2(np.sin(bearing).mean(), np.cos(bearing).mean())  # of the unit vectors to its cells
        sector = int(np.floor(mean / (2 * np.pi) * _SECTORS)) % _SECTORS
        self._views.setdefault((votes.source, sector, votes.stamp_ns // look), votes)

    def measured(self, at_once: bool) -> tuple[ReliabilityRecord, list[CellVotes]] | None:
        """Return a new record and the frames that the map counts again with it; None: there is none now. `at_once`:
        wait for the thread that measures."""
        if self._running is None and self.wanted and len(self._views) >= self._waiting[0]:
            self._waiting = [number for number in self._waiting if number > len(self._views)]
            executor = ThreadPoolExecutor(1, "measure_labels")
            self._running = executor.submit(self._measure, self._frames())
            executor.shutdown(wait=False)
        if self._running is None or not (at_once or self._running.done()):
            return None
        done, self._running = self._running, None
        frames, pending, self._pending = self._frames(), self._pending, []
        for votes in pending:
            self.take(votes)
        if not self._waiting:
            self._views.clear()
        try:
            record = done.result()
            if self._folder is not None:
                write_record(record, self._folder)
        except LtmError as error:
            self.failure = str(error)
            return None
        self.failure = ""
        return record, frames + pending

    def _frames(self) -> list[CellVotes]:
        return sorted(self._views.values(), key=lambda votes: (votes.stamp_ns, votes.source))

    def _measure(self, frames: list[CellVotes]) -> ReliabilityRecord:
        site, width = self._site, np.int64(self._geometry.width)
        source = f"{len(frames)} views of site {site.name} against its prior map, while its fuel map ran"
        errors = measured_errors(site, self._geometry, self._labels, frames, source)
        day = datetime.fromtimestamp(frames[-1].stamp_ns // 10**9, UTC).date()
        cells = len(np.unique(np.concatenate([f.rows * width + f.cols for f in frames])))
        live = f"{day}, {len(frames)} views, {cells} cells"
        about = {"network": Path(label_model(site)).stem, "labels": self._digest, "site": site.name, "live": live}
        return record_of(errors, source, **about)


class DriftWatch:
    """Counts frames into the charts of `LabelDrift` and reports a drift until it ends. The charts survive a restart,
    but for the days since the last closed week."""

    def __init__(self, labels: LabelSet, folder: Path | None, health: Health) -> None:
        file = None if folder is None else folder / DRIFT_FILE
        self._health = health
        try:
            self._drift = LabelDrift(labels, file)
        except LtmError as error:
            health.trouble("label_drift", f"{error}; the charts start again")
            self._drift = LabelDrift(labels, file, fresh=True)
        self._report()

    def take(self, votes: CellVotes, model: str, shown: ShownLayers) -> None:
        """Take a counted frame; `shown`: layers of the map before it."""
        if self._drift.wants_reference(votes.stamp_ns):
            if not shown.seen.any():
                return
            self._drift.set_reference(shown.life_form, shown.seen & ~shown.changed, votes.stamp_ns)
        if self._drift.take(votes, model):
            self._report()
            self.save()

    def _report(self) -> None:
        for camera, shares in self._drift.weeks().items():
            self._health.gauge(f"label_agreement.{camera}", f"{shares[-1]:.4f}")
            if len(shares) > 1:
                chart = " ".join(f"{share:.3f}" for share in shares[-_CHART_WEEKS:])
                self._health.gauge(f"label_weeks.{camera}", chart)
            self._health.gauge(f"label_drift_sigmas.{camera}", f"{drift_sigmas(shares):.2f}")
        self._health.lasting(self._drift.problem())

    def save(self) -> None:
        """Write the charts; a failure is reported and loses nothing in memory."""
        try:
            self._drift.save()
        except LtmError as error:
            self._health.trouble("label_drift", str(error))
