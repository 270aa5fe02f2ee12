from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes.small_site import SmallSite, write_small_site

from ltm_core.base.errors import StoreError
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.site_surface import confirmed_terrain, exported_terrain, surface_versions
from ltm_core.site.sections import DemConfig
from ltm_core.surface.confirmed_surface import ConfirmedSurface
from ltm_core.surface.surface_versions_io import FOLDER, ConfirmedTerrain
from ltm_core.vision.labels import LabelSet
from ltm_ros.fuel_map.export import write_landscapes

CELLS = np.arange(40, 52, dtype=np.int32)
BEGIN = 1_700_000_000_000_000_000


@pytest.fixture
def small(tmp_path: Path) -> SmallSite:
    (tmp_path / "site").mkdir()
    found = write_small_site(tmp_path / "site", recording=False)
    found.path.write_text(found.path.read_text() + yaml.safe_dump({"terrain": {"trace_confirmed": True}}))
    return SmallSite(found.folder)


def sunk(small: SmallSite, by: float) -> ConfirmedSurface:
    """A strip of 12 cells of 10 m in three rows, lower by so much."""
    rows, cols = (index.ravel().astype(np.int32) for index in np.meshgrid([30, 31, 32], CELLS, indexing="ij"))
    heights = small.dem.elevation[rows, cols] - np.float32(by)
    return ConfirmedSurface(small.dem.geometry, rows, cols, heights, heights)


def test_the_version_of_the_moment_is_exported_and_none_without_a_state(small: SmallSite, tmp_path: Path) -> None:
    state = tmp_path / "state"
    state.mkdir()
    versions = surface_versions(small.site, state / FOLDER)
    first, second = (versions.add(sunk(small, by), BEGIN + int(by), 500) for by in (4.0, 9.0))

    def lowest(terrain: ConfirmedTerrain) -> float:
        return float((small.dem.elevation - terrain.ground.elevation).max())

    now, then, before = (exported_terrain(small.site, state, m) for m in (None, BEGIN + 5, BEGIN))
    assert (now.version, then.version, before.version) == (second, first, None)
    assert [lowest(one) for one in (now, then, before)] == pytest.approx([9.0, 4.0, 0.0], abs=1e-3)
    assert exported_terrain(small.site, None).version is None
    plain = small.site.model_copy(update={"terrain": None})
    assert exported_terrain(plain, state).version is None
    elsewhere = exported_terrain(small.site, tmp_path)
    assert elsewhere.version is None
    assert f"{tmp_path / FOLDER} is not there" in elsewhere.note
    assert now.note == then.note == before.note == exported_terrain(plain, tmp_path).note == ""


def test_a_damaged_version_is_told_before_any_raster_is_opened(small: SmallSite, tmp_path: Path) -> None:
    """Nodes that follow try it again twice a second."""
    versions = surface_versions(small.site, tmp_path / FOLDER)
    entry = versions.add(sunk(small, 4.0), BEGIN, 500)
    versions.file(entry.version).write_bytes(b"cut")
    without = small.site.model_copy(update={"dem": DemConfig(path=tmp_path / "gone.tif")})
    with pytest.raises(StoreError, match="not the file written"):
        confirmed_terrain(without, versions, entry.version)


def test_landscapes_have_the_confirmed_ground_and_say_so(small: SmallSite, tmp_path: Path) -> None:
    import rasterio

    state, plain = tmp_path / "state", tmp_path / "plain"
    heights = {}
    for folder in (state, plain):
        folder.mkdir()
        if folder is state:
            entry = surface_versions(small.site, state / FOLDER).add(sunk(small, 60.0), BEGIN, 500)
        grid = small.site.fuel_geometry(small.dem)
        evidence = site_evidence_map(small.site, grid, LabelSet.load())
        # Cells without a code have no elevation: all are grass.
        evidence.recall(np.full(grid.shape, 102, np.int32))
        _, path = write_landscapes(evidence, small.site, folder, folder)
        with rasterio.open(path) as file:
            heights[folder.name], tags = file.read(1).astype(int), file.tags()
        assert ("surface" in tags) == (folder is state)
        if folder is state:
            assert tags["surface"].startswith(
                f"heights of surface {entry.version}, confirmed by views as of 2023-11-14"
            )
            assert "7.2% of 500 terrain cells seen" in tags["surface"]
            assert entry.version in tags["TIFFTAG_IMAGEDESCRIPTION"]
    lower = heights["plain"] - heights["state"]
    row, col = grid.cell_of(*small.dem.geometry.to_map(31, CELLS[1:-1]))
    assert (lower[row, col] > 25).all()
    assert (lower > 0).sum() < 20
