"""Plan an accuracy assessment: draw the sample of a fuel map's cells, and write and read the folder of the plan.

`plan.json` has the design, `cells.csv` the sampled cells for interpreters, and `map.npz` the assessed map, so that
later updates of the map do not change the assessment."""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from ltm_core.assessment.estimation import Stratum, drawn
from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, Int16Array, UInt8Array
from ltm_core.fuel.class_map import UNSEEN
from ltm_core.fuel.life_form import forms_of
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.config_io import load_arrays
from ltm_core.storage.disk_io import require_folder
from ltm_ros.assessment.answers_io import FORM_NAMES, Plan, read_plan, write_table
from ltm_ros.fuel_map.source import FuelSource

NAMES: Final = ("", *FORM_NAMES)
"""Names of the life forms by id."""
STORES: Final = ("fuel_map.ltm", "state/fuel_map.ltm", "map/fuel_map.ltm")


@dataclass(frozen=True, eq=False)
class AssessedMap:
    """The map of a plan, (H, W) each: life forms of the map and of the prior map, prior codes, changed, observed."""

    life_form: UInt8Array
    prior_form: UInt8Array
    prior: Int16Array
    changed: BoolArray
    observed: BoolArray


@dataclass(frozen=True, eq=False)
class MapPlan:
    """A plan with the map's answers. `grid`: of the map, in the site's CRS. `about`: content of `plan.json`."""

    shown: Plan
    about: dict[str, Any]
    strata: tuple[Stratum, ...]
    stratum: dict[int, int]
    grid: GridGeometry
    map: AssessedMap


def find_map(path: Path) -> Path:
    """Return the fuel map that a user names: the file itself, or the store in a folder of `ltm run` or `ltm demo`."""
    stores = (path / name for name in STORES) if path.is_dir() else ()
    return next((store for store in stores if store.is_file()), path)


def write_plan(source: FuelSource, path: Path, site: Path, wanted: int, seed: int, out: Path) -> dict[str, Any]:
    """Draw the sample of a map and write the plan to a folder; return the content of `plan.json`. Raises ConfigError if
    the folder already has a plan: answers would no longer fit its cells."""
    require_folder(out, "the plan")
    if (out / "plan.json").exists():
        raise ConfigError(f"{out}: contains a plan already; give another folder with --out")
    map_ = _map_of(source)
    sample = drawn(map_.life_form, map_.changed, map_.observed, NAMES, wanted, seed)
    grid = source.geometry
    x, y = grid.to_map(sample.rows, sample.columns)
    frame = source.site.frame
    lon, lat = frame.to_lonlat(x - frame.x_origin, y - frame.y_origin)
    about = {
        "version": 1,
        "seed": seed,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "map": _about(source, path),
        "site": str(site.resolve()),
        "crs": str(grid.crs),
        "cell_m": grid.resolution,
        "grid": [grid.x_min, grid.y_max, grid.width, grid.height],
        "strata": [asdict(stratum) | {"life_form": NAMES[stratum.map_class]} for stratum in sample.strata],
        "expected_half_width": {name: round(width, 4) for name, width in sample.half_widths().items()},
    }
    out.mkdir(parents=True, exist_ok=True)
    cells = (sample.rows * grid.width + sample.columns, sample.rows, sample.columns)
    places = zip(*(column.tolist() for column in cells), lon, lat, x, y, strict=True)
    formats = {"cell": "d", "row": "d", "column": "d", "lon": ".7f", "lat": ".7f", "x": ".2f", "y": ".2f"}
    rows = ({name: format(v, kind) for (name, kind), v in zip(formats.items(), one, strict=True)} for one in places)
    write_table(out / "cells.csv", list(formats), rows)
    np.savez_compressed(out / "map.npz", **vars(map_))
    (out / "plan.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    return about


def _map_of(source: FuelSource) -> AssessedMap:
    layers = source.layers
    observed = (layers.evidence > 0) & (layers.life_form != UNSEEN)
    return AssessedMap(layers.life_form, source.empty.life_form, layers.prior, layers.changed, observed)


def _about(source: FuelSource, path: Path) -> dict[str, str]:
    layers = source.layers
    digest = hashlib.sha256(layers.life_form.tobytes() + layers.code.tobytes()).hexdigest()
    return {"path": str(path.resolve()), "sha256": digest, "as_of": source.provenance(layers, None).as_of}


def with_map(plan: MapPlan, source: FuelSource, path: Path) -> MapPlan:
    """Return the plan with another map of its site, such as one after learning; sample and strata stay. Raises
    ConfigError for another grid, or if the map does not state a life form of each sampled cell."""
    map_ = replace(_map_of(source), observed=plan.map.observed)
    if source.geometry != plan.grid:
        raise ConfigError(f"{path}: has another grid than the plan; make a new plan")
    if unseen := sum(map_.life_form[cell.row, cell.column] == UNSEEN for cell in plan.shown.cells):
        raise ConfigError(f"{path}: has no life form in {unseen} of the plan's cells; make a new plan")
    return replace(plan, map=map_, about=plan.about | {"map": _about(source, path)})


def read_map_plan(folder: Path) -> MapPlan:
    """Read a plan with the map's answers. Raises ConfigError for a missing or invalid file."""
    shown = read_plan(folder)
    try:
        about = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
        strata = tuple(
            Stratum(str(s["name"]), NAMES.index(s["life_form"]), bool(s["changed"]), int(s["cells"]), int(s["sampled"]))
            for s in about["strata"]
        )
        x_min, y_max, width, height = about["grid"]
        grid = GridGeometry(x_min, y_max, shown.cell_m, width, height, shown.crs)
        names = list(AssessedMap.__dataclass_fields__)
        layers = load_arrays(folder / "map.npz", names, 2 * width * height + 1024, ConfigError)
        if wrong := next((array.shape for array in layers if array.shape != grid.shape), None):
            raise ConfigError(f"{folder}/map.npz: has {wrong} cells, the plan {grid.shape}; make a new plan")
        map_ = AssessedMap(*layers)
        index = {(stratum.map_class, stratum.changed): k for k, stratum in enumerate(strata)}
        forms, changed = map_.life_form, map_.changed
        stratum = {c.cell: index[forms[c.row, c.column], changed[c.row, c.column]] for c in shown.cells}
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ConfigError(f"{folder}: is not a complete plan ({error}); make one with `ltm assess plan`") from error
    return MapPlan(shown, about, strata, stratum, grid, map_)


def agrees_with_prior(prior: Int16Array, forms: UInt8Array) -> BoolArray:
    """Return (N,) whether life forms, ids, are among those that prior codes stand for."""
    allowed = forms_of(prior)
    return np.asarray(allowed[np.arange(len(forms)), forms.astype(np.int64) - 1], np.bool_)
