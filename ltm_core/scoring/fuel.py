"""Score fuel maps and their changes against truth."""

from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import BoolArray, Int16Array, Int64Array, UInt8Array
from ltm_core.fuel.class_map import UNSEEN
from ltm_core.fuel.life_form import LifeForm, forms_of
from ltm_core.geometry.geodesy import same_crs
from ltm_core.geometry.grid import GridGeometry


@dataclass(frozen=True, eq=False)
class FuelScore:
    """Score of a fuel map. `cells`: of the map. `seen`: with a class and a known truth. `right`: of those. `confusion`:
    (K, K) cells by [true class, mapped class]."""

    cells: int
    seen: int
    right: int
    confusion: Int64Array


def score_fuel(
    classes: UInt8Array, geometry: GridGeometry, truth: UInt8Array, truth_geometry: GridGeometry, class_count: int
) -> FuelScore:
    """Score a map on the cells that both rasters cover, in one CRS with coinciding cells. Raises RasterError where the
    grids' cells do not coincide, or their CRSs differ."""
    true = on_grid(truth, truth_geometry, geometry)
    both = (classes < class_count) & (true < class_count)
    confusion = np.bincount(
        true[both].astype(np.int64) * class_count + classes[both], minlength=class_count * class_count
    ).reshape(class_count, class_count)
    return FuelScore(classes.size, int(both.sum()), int(np.trace(confusion)), confusion)


def on_grid(truth: UInt8Array, truth_geometry: GridGeometry, geometry: GridGeometry) -> UInt8Array:
    """Return the classes of `truth_geometry` at the cells of `geometry`, UNSEEN where it has none. Raises RasterError
    where the grids' cells do not coincide, or their CRSs differ."""
    crs, truth_crs = geometry.crs, truth_geometry.crs
    if not same_crs(crs, truth_crs):
        raise RasterError(f"fuel map in {crs} cannot be scored against truth in {truth_crs}: warp one to the other")
    row, col = truth_geometry.to_grid(*geometry.to_map(0, 0))
    offset = np.array([row, col])
    if geometry.resolution != truth_geometry.resolution or np.abs(offset - np.round(offset)).max() > 1e-3:
        raise RasterError(f"fuel map on {geometry} cannot be scored against truth on {truth_geometry}: cells differ")
    rows, cols = np.indices(geometry.shape)
    rows, cols = rows + round(float(row)), cols + round(float(col))
    inside = truth_geometry.contains(rows, cols)
    true = np.full(geometry.shape, UNSEEN, np.uint8)
    true[inside] = truth[rows[inside], cols[inside]]
    return true


@dataclass(frozen=True)
class Share:
    """A share as a count out of a total."""

    count: int
    of: int

    @property
    def value(self) -> float:
        return self.count / self.of if self.of else float("nan")


@dataclass(frozen=True)
class MapScore:
    """Score over cells with votes and known truth. `right`: cells of the true life form. `found`: of cells whose true
    form is not the prior's, those that the map has changed to it: the producer's accuracy of change. `mistaken`: of the
    same cells, those that it has changed to another form. `false_flips`: of cells whose true form is the prior's, those
    that the map has changed. `by_form`: right cells and false flips of each true form."""

    name: str
    right: Share
    found: Share
    mistaken: Share
    false_flips: Share
    by_form: dict[str, tuple[Share, Share]]

    @property
    def prevalence(self) -> float:
        """Return the share of cells whose true form is not the prior's."""
        return self.found.of / (self.found.of + self.false_flips.of) if self.right.of else float("nan")


def score_map(
    name: str, life_form: UInt8Array, truth: UInt8Array, prior: Int16Array | None, seen: BoolArray
) -> MapScore:
    """Score a map, (H, W) each; `prior`: fuel codes, None: there is none, and nothing is a change then."""
    cells = seen & (truth >= 1) & (truth <= len(LifeForm))
    form, true = life_form[cells], truth[cells]
    right = form == true
    if prior is None:
        held = agrees = np.ones(len(true), np.bool_)
    else:
        held = held_forms(prior[cells], true)
        agrees = held_forms(prior[cells], np.where(form == UNSEEN, np.uint8(1), form)) | (form == UNSEEN)
    return MapScore(
        name,
        _share(right, np.ones_like(right)),
        _share(right, ~held),
        _share(~right & ~agrees, ~held),
        _share(~agrees, held),
        {
            shown.name.lower(): (_share(right, true == shown), _share(~agrees, held & (true == shown)))
            for shown in LifeForm
            if (true == shown).any()
        },
    )


def held_forms(prior: Int16Array, forms: UInt8Array) -> BoolArray:
    """Return (N,) whether a cell of this life form is unchanged from the prior's code; False if that has no form."""
    agreeing = forms_of(prior)
    return np.asarray(agreeing[np.arange(len(forms)), forms - 1] | ~agreeing.any(axis=1), np.bool_)


def _share(chosen: BoolArray, among: BoolArray) -> Share:
    return Share(int((chosen & among).sum()), int(among.sum()))
