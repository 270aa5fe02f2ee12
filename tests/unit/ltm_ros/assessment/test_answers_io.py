"""Answers and field plots as files."""

import json
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.geometry.geodesy import SiteFrame
from ltm_ros.assessment.answers_io import (
    Answer,
    Plan,
    read_answers,
    read_field_plots,
    read_plan,
    write_answers,
)

CRS = "EPSG:32611"
LON, LAT = -118.0, 34.0


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    """Two cells of 30 m side by side, and one 300 m to the east; (LON, LAT) lies in the first."""
    x, y = (float(value) for value in SiteFrame(CRS).from_lonlat(LON, LAT))
    rows = [f"{n},0,{n},{LON},{LAT},{x + east},{y}" for n, east in ((7, 0.0), (3, 30.0), (9, 300.0))]
    (tmp_path / "plan.json").write_text(json.dumps({"version": 1, "crs": CRS, "cell_m": 30, "site": "site.yaml"}))
    (tmp_path / "cells.csv").write_text("\n".join(["cell,row,column,lon,lat,x,y", *rows]) + "\n")
    return read_plan(tmp_path)


def test_answers_come_back_as_they_were(tmp_path: Path) -> None:
    answers = [
        Answer(7, "shrub", "sure", 4.5, "2026-06-01T12:00:00+00:00"),
        Answer(3, "grass", "unsure", 12.0, "2026-06-01T12:00:09+00:00"),
        Answer(9, "", "cannot_be_seen", 0.5, "2026-06-01T12:00:10+00:00"),
    ]
    path = tmp_path / "answers/first.csv"
    write_answers(path, answers)
    assert read_answers(path) == answers


@pytest.mark.parametrize(
    "line",
    [
        "7,lava,sure,1,t",
        "7,grass,certain,1,t",
        "7,grass,cannot_be_seen,1,t",
        "7,,sure,1,t",
        "x,grass,sure,1,t",
        "7,grass,sure,,nan,t",
        "7,grass,sure",
        "7,grass,sure,1,t\n7,shrub,sure,1,t",
    ],
)
def test_an_invalid_line_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"cell,life_form,certainty,seconds,time\n{line}\n")
    with pytest.raises(ConfigError, match=r"a\.csv") as raised:
        read_answers(path)
    assert "\n" not in str(raised.value)


def test_a_damaged_list_of_learned_cells_is_named(plan: Plan) -> None:
    (plan.folder / "learned.csv").write_text("cell\nx\n")
    with pytest.raises(ConfigError, match=r"learned\.csv"):
        plan.learned()


def geopackage(path: Path, plots: list[tuple[float, float, str, str]]) -> None:
    """Write the tables that OGC 12-128 requires for a layer of points, in UTM with a box in each header."""
    with closing(sqlite3.connect(path)) as base:
        base.execute("CREATE TABLE gpkg_spatial_ref_sys (srs_id, organization, organization_coordsys_id, definition)")
        base.execute("INSERT INTO gpkg_spatial_ref_sys VALUES (5, 'EPSG', 32611, '')")
        base.execute("CREATE TABLE gpkg_geometry_columns (table_name, column_name, srs_id)")
        base.execute("INSERT INTO gpkg_geometry_columns VALUES ('my plots', 'geom', 5)")
        base.execute('CREATE TABLE "my plots" (fid, geom, "Life form", date)')
        for number, (lon, lat, form, day) in enumerate(plots):
            x, y = (float(value) for value in SiteFrame(CRS).from_lonlat(lon, lat))
            blob = b"GP\x00\x03" + struct.pack("<i4d", 5, x, x, y, y) + b"\x01" + struct.pack("<Idd", 1, x, y)
            base.execute('INSERT INTO "my plots" VALUES (?, ?, ?, ?)', (number, blob, form, day))
        base.commit()


@pytest.mark.parametrize("suffix", [".csv", ".gpkg"])
def test_field_plots_in_sampled_cells_count_and_others_do_not(plan: Plan, suffix: str) -> None:
    degree = 1 / 92_400  # of a metre eastwards at this latitude
    rows = [
        (LON, LAT, "shrub", "2026-05-01"),
        (LON + 5 * degree, LAT, "Grass", "2026-05-20"),
        (LON + 31 * degree, LAT, "tree", "2026-05-02"),
        (LON + 100 * degree, LAT, "bare", "2026-05-03"),
    ]
    path = plan.folder / f"plots{suffix}"
    if suffix == ".csv":
        path.write_text("\n".join(["lon,lat,life form,date", *(",".join(map(str, row)) for row in rows)]))
    else:
        geopackage(path, rows)
    answers = {answer.cell: answer.life_form for answer in read_field_plots(path, plan)}
    assert answers == {7: "grass", 3: "tree"}, "the later of two plots of a cell counts"


@pytest.mark.parametrize("row", ["181,34,grass,2026-05-01", "-118,34,lava,2026-05-01", "-118,34,grass,May", "a,b,c,d"])
def test_an_invalid_plot_is_rejected(plan: Plan, row: str) -> None:
    path = plan.folder / "plots.csv"
    path.write_text(f"lon,lat,life_form,date\n{row}\n")
    with pytest.raises(ConfigError, match=r"plots\.csv"):
        read_field_plots(path, plan)


def test_a_file_that_is_no_geopackage_is_rejected(plan: Plan) -> None:
    path = plan.folder / "plots.gpkg"
    path.write_bytes(b"SQLite format 3\x00" + b"\xff" * 200)
    with pytest.raises(RasterError, match=r"plots\.gpkg"):
        read_field_plots(path, plan)
