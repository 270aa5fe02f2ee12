"""The colours of fuel models against those of LANDFIRE's own attribute tables."""

import struct
from pathlib import Path

import pytest

from ltm_core.fuel.codes import code_color


def attribute_table(path: Path) -> list[dict[str, str]]:
    """The rows of a dBASE file."""
    data = path.read_bytes()
    count, header, length = struct.unpack("<IHH", data[4:12])
    fields, at = [], 32
    while data[at] != 13:
        fields.append((data[at : at + 11].split(b"\0")[0].decode(), data[at + 16]))
        at += 32
    rows = []
    for start in range(header, header + count * length, length):
        row, place = {}, start + 1
        for name, width in fields:
            row[name] = data[place : place + width].decode("latin1").strip()
            place += width
        rows.append(row)
    return rows


@pytest.mark.parametrize("product", ["F40", "F13"])
def test_fuel_models_have_landfires_colours(shared_data: Path, product: str) -> None:
    rows = attribute_table(shared_data / f"fuels_vermont_landfire/LC22_{product}_230.tif.vat.dbf")
    given = {int(row["VALUE"]): tuple(int(row[band]) for band in "RGB") for row in rows if int(row["VALUE"]) > 0}
    # Non-burnable codes stand in both systems, with other colours; ours are those of the newer one.
    burnable = {code: color for code, color in given.items() if product == "F40" or code < 90}
    assert len(burnable) > 6
    assert {code: code_color(code) for code in burnable} == burnable
