import struct
from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.fuel.export.landscape import LANDSCAPE_BANDS, Landscape
from ltm_core.fuel.export.landscape_io import lcp_header, write_lcp
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry

GRID = GridGeometry(1_833_825.0, 2_617_605.0, 30.0, 13, 11, "EPSG:5070")


def landscape() -> Landscape:
    rng = np.random.default_rng(3)
    bands = np.stack(
        [
            rng.permutation(np.arange(143)).reshape(GRID.shape) + 300,  # more classes than a list takes
            rng.integers(0, 45, GRID.shape),
            rng.integers(-1, 360, GRID.shape) // 40 * 40,
            rng.choice([91, 102, 145, 165, 188], GRID.shape),
            rng.choice([0, 15, 55], GRID.shape),
            rng.choice([0, 110, 230], GRID.shape),
            rng.choice([0, 4], GRID.shape),
            rng.choice([0, 12], GRID.shape),
        ]
    ).astype(np.int16)
    bands[3, 2, 5] = bands[4, 2, 5] = NODATA
    return Landscape(bands, GRID)


def test_header_fields() -> None:
    header = lcp_header(landscape(), "of cameras")
    assert len(header) == 7316
    assert struct.unpack_from("<3i", header, 0) == (21, 20, 44)
    edges = (GRID.x_min, GRID.x_max, GRID.y_min, GRID.y_max)
    assert struct.unpack_from("<4d", header, 12) == edges
    assert struct.unpack_from("<2i", header, 4164) == (13, 11)
    assert struct.unpack_from("<4d", header, 4172) == (GRID.x_max, GRID.x_min, GRID.y_max, GRID.y_min)
    assert struct.unpack_from("<i2d", header, 4204) == (0, 30.0, 30.0)
    assert struct.unpack_from("<10h", header, 4224) == (0, 0, 2, 0, 1, 3, 3, 3, 0, 0)
    assert header[4244 + 256 : 4244 + 256 + 5] == b"slope"
    assert header[6804:].rstrip(b"\0") == b"of cameras"


def test_class_lists() -> None:
    made = landscape()
    header = lcp_header(made)
    for k, name in enumerate(LANDSCAPE_BANDS):
        low, high, count, *listed = struct.unpack_from("<103i", header, 44 + 412 * k)
        values = np.unique(made.band(name)[made.band(name) != NODATA])
        assert (low, high) == (values.min(), values.max())
        assert low <= high
        if len(values) > 99:
            assert (count, any(listed)) == (-1, False)
        else:
            assert count == len(values)
            assert listed[0] == 0
            assert listed[1 : count + 1] == sorted(values.tolist())
            assert not any(listed[count + 1 :])
    assert struct.unpack_from("<103i", header, 44 + 412 * 9) == (0,) * 103


def test_what_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cannot write|cannot be written"):
        write_lcp(tmp_path / "none/a.lcp", landscape())
    with pytest.raises(RasterError, match="needs a CRS"):
        Landscape(landscape().bands, GRID.translated(0, 0))
    with pytest.raises(RasterError, match="8 int16 bands"):
        Landscape(landscape().bands[:5], GRID)
