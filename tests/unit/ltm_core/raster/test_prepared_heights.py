import os
import re
import shutil
import stat
from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster import prepared_heights_io as module
from ltm_core.raster.dem import Dem, prepare_heights
from ltm_core.raster.dem_stack import DemStack

GRID = GridGeometry(480_000.0, 4_151_000.0, 10.0, 70, 45, "EPSG:26911")


@pytest.fixture(autouse=True)
def small_rasters_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LEAST_CELLS", 100)


def heights(base: float = 300.0) -> Dem:
    rows, cols = np.mgrid[: GRID.height, : GRID.width]
    elevation = (base + 0.7 * rows + 0.03 * cols * cols).astype(np.float32)
    elevation[4:6, 9:12] = np.nan
    return Dem(elevation, GRID)


@pytest.fixture
def raster(tmp_path: Path) -> Path:
    heights().save(tmp_path / "dem.tif")
    return tmp_path / "dem.tif"


def prepared_of(raster: Path) -> Path:
    (found,) = raster.parent.glob("dem.tif.*.ltm-heights.npy")
    return found


def is_mapped(dem: Dem) -> bool:
    """Whether the elevations lie in a file's pages."""
    address = dem.elevation.ctypes.data
    for line in Path("/proc/self/maps").read_text().splitlines():
        found = re.match(r"([0-9a-f]+)-([0-9a-f]+) ", line)
        assert found is not None
        if int(found[1], 16) <= address < int(found[2], 16):
            return line.endswith(".ltm-heights.npy")
    raise AssertionError(f"no mapping holds {address:x}")


def test_prepared_heights_are_those_of_the_raster(raster: Path) -> None:
    decoded = Dem.open(raster)
    assert prepare_heights(raster) == prepared_of(raster)
    mapped = Dem.open(raster)
    assert (is_mapped(decoded), is_mapped(mapped)) == (False, True)
    np.testing.assert_array_equal(mapped.elevation, decoded.elevation)
    assert mapped.geometry == decoded.geometry
    assert (mapped.elevation.dtype, mapped.elevation.flags.c_contiguous) == (np.dtype(np.float32), True)
    assert len(list(raster.parent.iterdir())) == 2
    assert prepare_heights(raster) is None, "it is there already"


@pytest.mark.parametrize("removed", [False, True])
def test_an_own_copy_of_mapped_heights_is_another_mapping(raster: Path, removed: bool) -> None:
    prepare_heights(raster)
    mapped = Dem.open(raster)
    if removed:
        prepared_of(raster).unlink()
    copied = module.own_copy(mapped.elevation)
    assert is_mapped(Dem(copied, GRID)) is not removed
    copied[0, 0] = 7.0
    assert mapped.elevation[0, 0] == heights().elevation[0, 0]
    np.testing.assert_array_equal(copied[1:], mapped.elevation[1:])


def test_what_is_written_to_mapped_heights_stays_in_the_process(raster: Path) -> None:
    """As a stack does where it leads the finest raster over to a coarser one."""
    wider = GridGeometry(GRID.x_min - 300, GRID.y_max + 300, 30.0, 44, 35, GRID.crs)
    Dem(np.full(wider.shape, 250.0, np.float32), wider).save(raster.with_name("coarse.tif"))
    decoded = DemStack.open(raster, None, (raster.with_name("coarse.tif"), None))
    prepare_heights(raster)
    mapped = DemStack.open(raster, None, (raster.with_name("coarse.tif"), None))
    assert is_mapped(mapped)
    np.testing.assert_array_equal(mapped.elevation, decoded.elevation)
    assert np.isfinite(mapped.elevation[4:6, 9:12]).all()
    np.testing.assert_array_equal(Dem.open(raster).elevation, heights().elevation)


@pytest.mark.parametrize("what", ["content", "date kept", "replaced", "sidecar", "version", "cut", "header"])
def test_any_other_state_of_the_raster_has_none(raster: Path, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    prepare_heights(raster)
    prepared, before = prepared_of(raster), raster.stat()
    expected = heights()
    if what in ("content", "date kept"):
        expected = heights(900.0)
        expected.save(raster.with_name("other.tif"))
        raster.write_bytes(raster.with_name("other.tif").read_bytes())
        if what == "date kept":
            os.utime(raster, ns=(before.st_atime_ns, before.st_mtime_ns))
    if what == "replaced":
        shutil.copy2(raster, raster.with_name("same.tif"))
        raster.with_name("same.tif").replace(raster)
    if what == "sidecar":
        statistics = '<PAMDataset><PAMRasterBand band="1"><Description>z</Description></PAMRasterBand></PAMDataset>'
        raster.with_name("dem.tif.aux.xml").write_text(statistics)
    if what == "version":
        monkeypatch.setattr(module, "VERSION", module.VERSION + 1)
    if what == "cut":
        os.truncate(prepared, prepared.stat().st_size - 1)
    if what == "header":
        content = prepared.read_bytes()
        prepared.write_bytes(b"x" + content[1:])
    found = Dem.open(raster)
    assert not is_mapped(found)
    np.testing.assert_array_equal(found.elevation, expected.elevation)
    assert prepare_heights(raster) == prepared_of(raster)
    assert is_mapped(Dem.open(raster))
    np.testing.assert_array_equal(Dem.open(raster).elevation, expected.elevation)


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o644, 0o666])
def test_who_may_not_read_the_raster_may_not_read_its_heights(raster: Path, mode: int) -> None:
    raster.chmod(mode)
    prepare_heights(raster)
    assert stat.S_IMODE(prepared_of(raster).stat().st_mode) == mode & 0o644


@pytest.mark.skipif(os.geteuid() != 0, reason="gives files away, which takes root")
def test_heights_of_a_stranger_are_not_believed(raster: Path) -> None:
    """Who may write into the folder, and not the raster."""
    prepare_heights(raster)
    os.chown(prepared_of(raster), 4711, -1)
    assert not is_mapped(Dem.open(raster))
    assert prepare_heights(raster) == prepared_of(raster)
    assert is_mapped(Dem.open(raster))
    for path in (raster, prepared_of(raster)):
        os.chown(path, 4711, -1)
    prepare_heights(raster)
    os.chown(prepared_of(raster), 4711, -1)
    assert is_mapped(Dem.open(raster)), "the raster's owner may"


def test_errors_leave_nothing(raster: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RasterError):
        prepare_heights(raster.with_name("absent.tif"))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OSError, match="No space"):
        prepare_heights(raster)
    assert sorted(path.name for path in raster.parent.iterdir()) == ["dem.tif"]


@pytest.mark.parametrize("why", ["too small", "no room"])
def test_what_another_state_left_does_not_stay(raster: Path, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    prepare_heights(raster)
    heights(900.0).save(raster.with_name("other.tif"))
    raster.with_name("other.tif").replace(raster)
    raster.with_name("dem.tif.0123.ltm-heights.npykilled").write_bytes(b"cut short")
    monkeypatch.setattr(module, *{"too small": ("LEAST_CELLS", 1 << 40), "no room": ("SPARE_BYTES", 1 << 60)}[why])
    assert prepare_heights(raster) is None
    assert [path.name for path in raster.parent.iterdir()] == ["dem.tif"]
