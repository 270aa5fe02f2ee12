"""Read and write reference answers for the sampled cells of a plan: of interpreters, and of field plots.

A plan is a folder: `plan.json`, `cells.csv` (sampled cells without the map's answer), `answers/NAME.csv` (one file for
each interpreter) and `learned.csv` (cells that the network has learned from)."""

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import Field
from pydantic.dataclasses import dataclass
from pyproj import Transformer

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import problem_text
from ltm_core.fuel.life_form import LifeForm
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.raster.geopackage_io import read_points
from ltm_core.storage.config_io import LARGEST_TABLE, read_text
from ltm_core.storage.disk_io import make_folder
from ltm_core.vision.areas import replace_file

Certainty = Literal["sure", "likely", "unsure", "cannot_be_seen"]
FORM_NAMES: Final = tuple(form.name.lower() for form in LifeForm)


@dataclass(frozen=True)
class Answer:
    """What an interpreter saw in a cell. `life_form`: "" if it cannot be seen. `seconds`: time taken for the answer.
    `time`: when it was given, ISO 8601 UTC. Raises ValueError for another life form, certainty or number."""

    cell: int
    life_form: str
    certainty: Certainty
    seconds: Annotated[float, Field(ge=0, le=86400)]
    time: str

    def __post_init__(self) -> None:
        if self.life_form not in (("",) if self.certainty == "cannot_be_seen" else FORM_NAMES):
            raise ValueError(
                f"life form {self.life_form!r} of cell {self.cell} does not fit {self.certainty!r}; use "
                f"{', '.join(FORM_NAMES)}, and none for a cell that cannot be seen"
            )


@dataclass(frozen=True)
class SampledCell:
    """A row of `cells.csv`. `x`, `y`: centre in the plan's CRS, metres."""

    cell: int
    row: int
    column: int
    lon: float
    lat: float
    x: float
    y: float


@dataclass(frozen=True)
class Plan:
    """The part of a plan that interpreters may know. `cells`: in the order in which they are shown. `site`: path of the
    site file."""

    folder: Path
    crs: str
    cell_m: float
    cells: tuple[SampledCell, ...]
    site: str

    def answers_file(self, interpreter: str) -> Path:
        """Return the file of an interpreter. Raises ConfigError for a name that cannot be a file's."""
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}", interpreter):
            raise ConfigError(f"interpreter {interpreter[:60]!r}: use 1 to 40 letters, digits, - and _")
        return self.folder / "answers" / f"{interpreter}.csv"

    def interpreters(self) -> list[str]:
        """Return the names of all who have given answers."""
        return sorted(path.stem for path in (self.folder / "answers").glob("*.csv"))

    def learned(self) -> frozenset[int]:
        """Return the cells that the network has learned from; they must not count in a report. Raises
        ConfigError for an invalid file."""
        path = self.folder / "learned.csv"
        try:
            return frozenset(int(row["cell"]) for row in _rows(path, ("cell",))) if path.exists() else frozenset()
        except ValueError as error:
            raise ConfigError(f"{path}: {error}; run `ltm assess learn` again") from error


def read_plan(folder: Path) -> Plan:
    """Read a plan without the map's answers. Raises ConfigError for a missing or invalid file."""
    path = folder / "plan.json"
    try:
        about = json.loads(read_text(path, LARGEST_TABLE, ConfigError))
        crs, cell_m, site = str(about["crs"]), float(about["cell_m"]), str(about["site"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ConfigError(f"{path}: is not a plan ({error}); make one with `ltm assess plan`") from error
    if not 0 < cell_m < math.inf:
        raise ConfigError(f"{path}: cell_m is {cell_m}; make the plan again with `ltm assess plan`")
    cells = _records(folder / "cells.csv", SampledCell, "make the plan again with `ltm assess plan`")
    if not cells:
        raise ConfigError(f"{folder}/cells.csv: has no cells; make the plan again with `ltm assess plan`")
    return Plan(folder, crs, cell_m, tuple(cells), site)


def read_answers(path: Path) -> list[Answer]:
    """Read an interpreter's answers, at most one for each cell. Raises ConfigError with the line of an invalid one."""
    return _records(path, Answer, "correct or delete this line")


def write_answers(path: Path, answers: Iterable[Answer]) -> None:
    """Write an interpreter's answers, atomically. Raises OSError, ConfigError."""
    make_folder(path.parent)
    write_table(path, [field.name for field in fields(Answer)], map(asdict, answers))


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a CSV file, atomically; None becomes an empty value. Raises OSError."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    replace_file(path, text.getvalue().encode())


def read_field_plots(path: Path, plan: Plan) -> list[Answer]:
    """Read field plots (lon, lat, life form, date) from a CSV file or a GeoPackage as sure answers for sampled cells.
    The latest plot of a cell counts. Plots elsewhere are ignored: they were not drawn at random. Raises ConfigError,
    RasterError for an invalid file."""
    if path.suffix.lower() == ".gpkg":
        rows, crs = read_points(path)
        if missing := [part for part in ("life_form", "date") if rows and part not in rows[0]]:
            raise ConfigError(f"{path}: the layer has no column {missing[0]}")
        to_degrees = Transformer.from_crs(crs, 4326, always_xy=True)
        rows = [row | dict(zip(("lon", "lat"), to_degrees.transform(row["x"], row["y"]), strict=True)) for row in rows]
    else:
        rows = _rows(path, ("lon", "lat", "life_form", "date"))
    half, frame, visited = plan.cell_m / 2, SiteFrame(plan.crs), list[Answer]()
    for number, row in enumerate(rows, 1):
        form, day = str(row["life_form"]).strip().lower(), str(row["date"])[:10]
        try:
            lon, lat = float(row["lon"]), float(row["lat"])
            date.fromisoformat(day)
            if not (abs(lon) <= 180 and abs(lat) <= 90):
                raise ValueError(f"lon {lon}, lat {lat} are not degrees")
            if form not in FORM_NAMES:
                raise ValueError(f"life form {form!r} is unknown; use {', '.join(FORM_NAMES)}")
        except (ValueError, TypeError) as error:
            raise ConfigError(f"{path}: plot {number}: {error}") from error
        x, y = (float(value) for value in frame.from_lonlat(lon, lat))
        inside = [c.cell for c in plan.cells if -half <= x - c.x < half and -half < y - c.y <= half]
        visited += [Answer(cell, form, "sure", 0.0, day) for cell in inside]
    return list({answer.cell: answer for answer in sorted(visited, key=lambda answer: answer.time)}.values())


_Row = TypeVar("_Row", Answer, SampledCell)


def _records(path: Path, kind: type[_Row], remedy: str) -> list[_Row]:
    """Return the rows of a CSV file, at most one for each cell. Raises ConfigError with the line of an invalid one."""
    names, found = [field.name for field in fields(kind)], dict[int, _Row]()
    for number, row in enumerate(_rows(path, names), 2):
        try:
            record = kind(**{name: row[name] for name in names})
            if record.cell in found:
                raise ValueError(f"cell {record.cell} is listed twice")
        except ValueError as error:
            raise ConfigError(f"{path}: line {number}: {problem_text(error)}; {remedy}") from error
        found[record.cell] = record
    return list(found.values())


def _rows(path: Path, columns: Iterable[str]) -> list[dict[str, Any]]:
    """Return the rows of a CSV file with at least these columns; a space in a heading counts as an underscore."""
    reader = csv.reader(io.StringIO(read_text(path, LARGEST_TABLE, ConfigError, "utf-8-sig")))
    try:
        head = [name.strip().lower().replace(" ", "_") for name in next(reader, [])]
        if missing := [name for name in columns if name not in head]:
            raise ConfigError(f"{path}: has no column {missing[0]}; its columns are {', '.join(head) or '(none)'}")
        rows = [row for row in reader if row]
    except csv.Error as error:
        raise ConfigError(f"{path}: line {reader.line_num}: {error}") from error
    if short := next((row for row in rows if len(row) != len(head)), None):
        raise ConfigError(f"{path}: row {','.join(short)[:60]!r} has {len(short)} values, expected {len(head)}")
    return [dict(zip(head, row, strict=True)) for row in rows]
