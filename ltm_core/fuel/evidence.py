"""Bayesian fuel map: evidence for the life form of each cell, by view and time, over the prior map.

A cell's life form has a Dirichlet distribution. Its parameters are kappa pi(l | the prior's life form) plus evidence.
What a frame shows (`frame_evidence`) is kept by view, the direction from the camera to the cell, and by epoch; of each
view the newest epochs are kept. Weight and fuel code (`decision`) are functions of that state and of the time of the
query, so that frames may come late and in any order. docs/how/fuel.md has the mathematics."""

import zlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ImageError, RasterError
from ltm_core.base.types import BoolArray, Int16Array, UInt8Array
from ltm_core.fuel.codes import FuelClimate
from ltm_core.fuel.decision import CellEvidence, ChangeDecision, FuelLayers
from ltm_core.fuel.evidence_kernel import accumulate, pooled
from ltm_core.fuel.frame_evidence import frame_evidence
from ltm_core.fuel.label_errors import ALIKE, FLOOR, UNMEASURED, LabelErrors
from ltm_core.fuel.life_form import FORMS, NODATA, LifeForm, forms_of, label_forms
from ltm_core.fuel.prior import FuelPrior, system_of
from ltm_core.fuel.rules import GROWTH, FusionRules
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.tile_store_schema import Field
from ltm_core.vision.labels import LabelSet

Window = tuple[int, int, int, int]
"""Part of the grid: (row, col, height, width)."""
Key = tuple[int, int]

_LATEST_NS = (2**32 - 1) * 10**9
CAMERAS_KEPT: Final = 8
"""Maximum number of cameras that a cell records; of more, those with the smallest name hashes are kept."""
VIEWS: Final = 6
"""Number of directions from which a cell is seen. Frames from one direction are one view, whichever cameras took them:
they see the same side of the same plants, and the network makes the same errors."""
EPOCHS: Final = 2
"""Number of most recent epochs kept for each view; newer observations of a view replace older ones."""
EPOCH_S: Final = 10 * 86400
"""Length of an epoch in seconds, long enough for several weather situations."""
UNIT: Final = 256
"""Resolution of evidence: it is kept as integer multiples of 1 / UNIT, so that sums do not depend on the order."""
TILE: Final = 32
"""Number of cells per side of the state's tiles."""
EVIDENCE_VERSION: Final = 4
EVIDENCE_FIELDS: Final[Mapping[str, Field]] = {
    "shown": Field(np.uint32, (VIEWS, EPOCHS, FORMS)),  # sum of what the frames say for each form
    "best": Field(np.uint16, (VIEWS, EPOCHS)),  # the most that a frame says
    "span": Field(np.uint32, (VIEWS, EPOCHS, 2)),  # seconds of the earliest and the latest frame; 0 none
    "epochs": Field(np.uint16, (VIEWS, EPOCHS)),  # their numbers from 1970 on, newest first; 0 none
    "first": Field(np.uint32, (FORMS,)),  # second of the earliest frame that shows the form; 0 none
    "last": Field(np.uint32, (FORMS,)),  # of the latest
    "camera_hashes": Field(np.uint32, (FORMS, 2)),  # hashes of two cameras that show the form; 0 none
    "seen_by": Field(np.uint32, (CAMERAS_KEPT,)),  # hashes of cameras that see the cell, rising; 0 none
    "last_seen": Field(np.uint32),  # second of the latest frame
    "burned_at": Field(np.uint32),  # second of the latest burn added to the map; 0 none
}
"""State of a cell. Seconds count from 1970; a tile is an array of each field, (tile, tile, *shape)."""


SURFACE_KINDS: Final = 1000
"""Factor of a cell's recorded surface change: the kind of change times this, plus the code from which the cell starts
since then (0: that of its prior)."""


def camera_hash(source: str) -> int:
    """Return the identifier of a camera in cells: CRC-32 of its name, never 0."""
    return zlib.crc32(source.encode()) or 1


class EvidenceMap:
    """Accumulate the votes of frames, which must be on the fuel grid `geometry`, and derive the fuel map from them and
    the prior, which the code of what stands there now replaces where the surface has changed. Raises RasterError for a
    prior on another grid.

    Args:
        prior: the map that evidence starts from; None: nothing is known, each life form is as likely.
        labels: what the votes count.
        errors: of the network that labels; None: those of a network that was never measured.
        errors_of: camera -> those of its network, where that is another; of the correlations, those of `errors` hold,
            or ALIKE if any network was never measured.
        climate: which codes changed cells get."""

    def __init__(
        self,
        geometry: GridGeometry,
        prior: FuelPrior | None,
        labels: LabelSet,
        rules: FusionRules | None = None,
        errors: LabelErrors | None = None,
        climate: FuelClimate | None = None,
        errors_of: Mapping[str, LabelErrors] | None = None,
    ) -> None:
        if prior is not None and prior.codes.shape != geometry.shape:
            raise RasterError(f"the prior is {prior.codes.shape} cells, the fuel grid {geometry.shape}")
        self.geometry = geometry
        self.prior = self._given = prior
        self._codes: Int16Array = np.full(geometry.shape, NODATA, np.int16) if prior is None else prior.codes
        self.surface_changes = np.zeros(geometry.shape, np.int32)
        """(H, W): recorded surface change of each cell (`SURFACE_KINDS`), 0 for none."""
        self.rules = rules if rules is not None else FusionRules()
        self.climate = climate if climate is not None else FuelClimate.named("dry")
        self.newest_ns = 0
        """Latest counted stamp, rounded to seconds: the time of the map."""
        self._errors = errors if errors is not None else UNMEASURED
        self._errors_of = dict(errors_of or {})
        all_measured = all(known.measured for known in (self._errors, *self._errors_of.values()))
        self._correlation = self._errors.correlation if all_measured else ALIKE
        self._one_view = min(known.one_view for known in (self._errors, *self._errors_of.values()))
        self._forms = label_forms(labels)
        # Cells of which the prior says the same are of one stand.
        self._stands = None if prior is None else np.packbits(forms_of(prior.codes), axis=-1)[..., 0]
        self._decider = ChangeDecision(system_of(prior), self.rules, self.climate)
        years = self.rules.decay_years.model_dump()
        self._decay_s = np.array([years[form.name.lower()] for form in LifeForm]) * (365.25 * 86400)
        # calloc'ed: cells that no frame sees take no memory.
        self._state = {
            name: np.zeros((*geometry.shape, *field.shape), np.dtype(field.dtype))
            for name, field in EVIDENCE_FIELDS.items()
        }

    def add(self, votes: CellVotes) -> Window | None:
        """Count a frame; return the part of the grid that it touches, or None if it has no votes. The frame must not
        have been counted before. Raises ImageError for votes on another grid, over other classes, or of a time that is
        not in 1970 to 2106."""
        if votes.geometry != self.geometry:
            raise ImageError(f"votes of {votes.source} are on {votes.geometry}, but this map is on {self.geometry}")
        if not 0 <= votes.stamp_ns < _LATEST_NS:
            raise ImageError(f"votes of {votes.source} have the stamp {votes.stamp_ns} ns, outside 1970 to 2106")
        errors = self._errors_of.get(votes.source, self._errors)
        frame = frame_evidence(votes, self._forms, errors, self.rules, self._stands)
        if len(frame) == 0:
            return None
        second, views = max(votes.stamp_ns // 10**9, 1), np.full(len(frame), camera_hash(votes.source) % VIEWS)
        if frame.bearing is not None:
            views = np.floor(frame.bearing * (VIEWS / (2 * np.pi))).astype(np.int64) % VIEWS
        accumulate(
            frame.rows,
            frame.cols,
            np.floor(frame.amounts * UNIT + 0.5).astype(np.uint32),
            frame.supported,
            views,
            np.uint32(second),
            np.uint16(1 + second // EPOCH_S),
            np.uint32(camera_hash(votes.source)),
            tuple(self._state.values()),
        )
        self.newest_ns = max(self.newest_ns, second * 10**9)
        row, col = int(frame.rows.min()), int(frame.cols.min())
        return row, col, int(frame.rows.max()) - row + 1, int(frame.cols.max()) - col + 1

    def burn(self, cells: BoolArray, stamp_ns: int) -> None:
        """Mark the cells (H, W) as burned at that time; earlier evidence is void, even if it arrives later. Tell it
        once it is known: evidence of frames after the burn that came before this call is lost too."""
        if cells.shape != self.geometry.shape:
            raise ImageError(f"burned cells of shape {cells.shape} do not fit a fuel grid of {self.geometry.shape}")
        if not 0 <= stamp_ns < _LATEST_NS:
            raise ImageError(f"a burn has the stamp {stamp_ns} ns, outside 1970 to 2106")
        second = max(stamp_ns // 10**9, 1)
        fresh = cells & (self._state["burned_at"] < second)
        for name, array in self._state.items():
            array[fresh] = second if name == "burned_at" else 0
        self.newest_ns = max(self.newest_ns, second * 10**9)

    def reached_from(self, window: Window) -> Window:
        """Return the part of the grid whose layers depend on evidence in a window."""
        row, col, height, width = window
        reach = self.rules.support_cells + 1 + GROWTH
        top, left = max(row - reach, 0), max(col - reach, 0)
        bottom, right = min(row + height + reach, self.geometry.height), min(col + width + reach, self.geometry.width)
        return top, left, bottom - top, right - left

    def layers(self, window: Window | None = None, at_ns: int | None = None) -> FuelLayers:
        """Return the map, or a part of it, at a time; by default that of the latest frame. Its `prior` is the initial
        one, also where the surface has changed."""
        wanted = window or (0, 0, *self.geometry.shape)
        initial = self._codes[self._slices(wanted)].copy()
        around = self.reached_from(wanted)
        row, col = wanted[0] - around[0], wanted[1] - around[1]
        return replace(self._layers(around, at_ns).part(row, col, wanted[2], wanted[3]), prior=initial)

    @property
    def change_kinds(self) -> UInt8Array:
        """Return (H, W) ChangeKind of the recorded surface changes."""
        return (self.surface_changes // SURFACE_KINDS).astype(np.uint8)

    def recall(self, recorded: NDArray[np.integer]) -> None:
        """Put back what `surface_changes` was, (H, W)."""
        self.surface_changes = recorded.astype(np.int32)
        starts = self.surface_changes % SURFACE_KINDS
        codes = np.where(starts > 0, starts, self._codes).astype(np.int16)
        if self._given is not None:
            self.prior = replace(self._given, codes=codes)
        else:
            self.prior = FuelPrior(codes, self.geometry) if (starts > 0).any() else None

    def _layers(self, window: Window, at_ns: int | None) -> FuelLayers:
        part = self._slices(window)
        state = {name: array[part] for name, array in self._state.items()}
        codes = (self._codes if self.prior is None else self.prior.codes)[part]
        now = (self.newest_ns if at_ns is None else at_ns) / 1e9
        touched = (state["last_seen"] > 0) | (state["burned_at"] > 0)
        alike = self._correlation.between_frames, self._correlation.between_views
        observed = (state[name][touched] for name in ("shown", "best", "span"))
        full = self.rules.frame_cap * UNIT
        worth, log_likelihood = pooled(*observed, now, self._decay_s, self.rules.look_s, *alike, full, FLOOR)
        if self._one_view < 1:
            lone = (state["best"][touched].max(axis=-1) > 0).sum(axis=-1) < 2
            log_likelihood[lone] *= self._one_view
        cells = CellEvidence(
            evidence=worth / UNIT,
            log_likelihood=log_likelihood,
            first=state["first"][touched],
            last=state["last"][touched],
            cameras=(state["camera_hashes"][touched] > 0).sum(axis=-1),
            burned_at=state["burned_at"][touched],
        )
        starts = (self.surface_changes[part] % SURFACE_KINDS).astype(np.int16)
        by_surface = None
        if starts.any():
            by_surface = np.where(starts > 0, forms_of(starts).argmax(axis=-1) + 1, 0).astype(np.uint8)
        layers = self._decider.decide(codes, touched, cells, now, by_surface)
        layers.last_seen[...] = state["last_seen"].astype(np.int64) * 10**9
        layers.seen_by[...] = (state["seen_by"] > 0).sum(axis=-1)
        return layers

    def tiles_of(self, window: Window) -> list[Key]:
        """Return (row, col) of the tiles that hold a part of the grid, in row-major order."""
        row, col, height, width = window
        rows = range(row // TILE, (row + height - 1) // TILE + 1)
        return [(r, c) for r in rows for c in range(col // TILE, (col + width - 1) // TILE + 1)]

    def tile_state(self, key: Key) -> dict[str, NDArray[Any]]:
        """Return a copy of a tile's state by field, (TILE, TILE, *shape); zeros beyond the grid's edges."""
        part = self._tile_slices(key)
        result = {}
        for name, field in EVIDENCE_FIELDS.items():
            whole = np.zeros((TILE, TILE, *field.shape), np.dtype(field.dtype))
            content = self._state[name][part]
            whole[: content.shape[0], : content.shape[1]] = content
            result[name] = whole
        return result

    def load_tile(self, key: Key, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Put back what `tile_state` gave. Raises RasterError on arrays that are not such."""
        part = self._tile_slices(key)
        for name, field in EVIDENCE_FIELDS.items():
            array = arrays.get(name)
            wanted = (TILE, TILE, *field.shape)
            if array is None or array.shape != wanted or array.dtype != np.dtype(field.dtype):
                found = "absent" if array is None else f"{array.shape} {array.dtype}"
                raise RasterError(f"field {name} of tile {key} is {found}, must be {wanted} {np.dtype(field.dtype)}")
            target = self._state[name][part]
            target[...] = array[: target.shape[0], : target.shape[1]]
        newest = max(int(self._state["last_seen"][part].max()), int(self._state["burned_at"][part].max()))
        self.newest_ns = max(self.newest_ns, newest * 10**9)

    def _tile_slices(self, key: Key) -> tuple[slice, slice]:
        tiles = tuple(-(-n // TILE) for n in self.geometry.shape)
        if not (0 <= key[0] < tiles[0] and 0 <= key[1] < tiles[1]):
            raise RasterError(f"tile {key} is outside a grid of {tiles} tiles")
        return slice(key[0] * TILE, (key[0] + 1) * TILE), slice(key[1] * TILE, (key[1] + 1) * TILE)

    def _slices(self, window: Window) -> tuple[slice, slice]:
        row, col, height, width = window
        if row < 0 or col < 0 or row + height > self.geometry.height or col + width > self.geometry.width:
            raise RasterError(f"window {window} is not within a fuel grid of {self.geometry.shape}")
        return slice(row, row + height), slice(col, col + width)
