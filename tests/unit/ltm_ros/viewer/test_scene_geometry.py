import numpy as np
import pytest
from scenes.rerun_site import LABELS, hills

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from ltm_ros.viewer import scene_geometry


def test_decimated_terrain_keeps_every_height_at_its_place() -> None:
    dem = hills()
    for most in (100_000, 3000, 700):
        coarse = scene_geometry.decimated(dem, most)
        rows, cols = coarse.elevation.shape
        assert 2 * (rows - 1) * (cols - 1) <= most
        x, y = coarse.geometry.to_map(*np.mgrid[:rows, :cols])
        np.testing.assert_allclose(dem.elevation_at(x, y), coarse.elevation, atol=1e-3)


def test_terrain_mesh_faces_up_and_skips_what_is_unknown() -> None:
    dem = hills()
    elevation = dem.elevation.copy()
    elevation[10, 20] = np.nan
    mesh = scene_geometry.terrain_mesh(Dem(elevation, dem.geometry))
    assert len(mesh["triangle_indices"]) == 2 * 69 * 109 - 6, "a lone vertex belongs to six triangles"
    vertices, texcoords = mesh["vertex_positions"], mesh["vertex_texcoords"]
    corners = vertices[mesh["triangle_indices"]].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    assert np.isfinite(vertices).all()
    assert texcoords.min() > 0
    assert texcoords.max() < 1
    north_west = np.argmin(vertices[:, 0] - vertices[:, 1])
    np.testing.assert_allclose(texcoords[north_west], (0.5 / 110, 0.5 / 70), rtol=1e-4)


def test_fuel_cells_lie_just_above_the_drawn_terrain() -> None:
    dem = hills()
    geometry = GridGeometry(-600.0, 900.0, 30.0, 50, 40)
    layer = scene_geometry.FuelLayer(dem, geometry, LABELS)
    classes = np.full(geometry.shape, 255, np.uint8)
    classes[33, 45] = 3
    ((name, tile),) = layer.changed(classes)
    assert name == "r001_c001"
    vertices = tile["vertex_positions"]
    x, y = geometry.to_map([32.5, 33.5], [44.5, 45.5])
    np.testing.assert_allclose(np.unique(vertices[:, 0]), x, atol=1e-3)
    np.testing.assert_allclose(np.unique(vertices[:, 1]), np.sort(y), atol=1e-3)
    corner = vertices.astype(np.float64)
    middles = [corner[list(pair)].mean(axis=0) for pair in ((0, 1), (0, 2), (1, 3), (2, 3), (1, 2))]
    over = np.concatenate([corner, middles])
    above = over[:, 2] - dem.elevation_at(over[:, 0], over[:, 1])
    assert above.min() > 3.6 - 1e-2, "terrain does not poke through"
    assert above.max() < 6.0, "and the cell lies close above it"
    np.testing.assert_array_equal(tile["vertex_colors"], [LABELS.colors[3]] * 4)
    corners = vertices[tile["triangle_indices"]].astype(np.float64)
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()


def test_fuel_layer_gives_only_what_has_changed() -> None:
    geometry = GridGeometry(-600.0, 900.0, 30.0, 50, 40)
    layer = scene_geometry.FuelLayer(hills(), geometry, LABELS)
    classes = np.full(geometry.shape, 255, np.uint8)
    assert list(layer.changed(classes)) == []
    classes[2, 3] = classes[2, 40] = classes[35, 4] = 1
    assert [name for name, _ in layer.changed(classes)] == ["r000_c000", "r000_c001", "r001_c000"]
    assert list(layer.changed(classes)) == []
    classes[2, 40] = 255
    ((name, emptied),) = layer.changed(classes)
    assert name == "r000_c001"
    assert len(emptied["triangle_indices"]) == len(emptied["vertex_positions"]) == 0
    with pytest.raises(RasterError, match=r"\(40, 49\)"):
        list(layer.changed(classes[:, 1:]))
