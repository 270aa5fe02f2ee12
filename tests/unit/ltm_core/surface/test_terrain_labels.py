from dataclasses import replace

import numpy as np
import pytest
from scenes.terrain_hillside import BARE, CAMERA, PATCH, PLACES, RULES, dem, frame

from ltm_core.base.types import BoolArray, Float32Array, Int64Array, UInt8Array
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.observation import DepthFrame
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import Label

HEIGHT = 8.0
STAND = BARE + HEIGHT * PATCH
GONE = np.zeros(256, np.float32)
"""Log odds that a patch of a label is open, as of a network that is right on nine of ten cells."""
GONE[[Label.GRASS, Label.SHRUB, Label.TREE, Label.BARE]] = 3.5, -2.0, -3.5, 3.9
SEEN: dict[str, tuple[Int64Array, Int64Array]] = {}
"""Row and column of the cell that each pixel of a camera would see if the stand stood."""


def stand_map(gone: Float32Array | None = GONE) -> SurfaceMap:
    return SurfaceMap(Reference.of(dem(BARE), dem(STAND)), RULES, tuple(PLACES), gone=gone)


def shown(source: str, cells: BoolArray = PATCH) -> BoolArray:
    """Pixels in which a camera would see these cells if the stand stood."""
    if source not in SEEN:
        points = np.nan_to_num(TerrainTracer(dem(STAND)).trace(CAMERA, frame(STAND, source).pose).points())
        row, col = dem(BARE).geometry.cell_of(points[..., 0], points[..., 1])
        inside = dem(BARE).geometry.contains(row, col)
        SEEN[source] = np.where(inside, row, 0), np.where(inside, col, 0)
    return np.asarray(cells[SEEN[source]], np.bool_)


def labelled(source: str, hours: float, labels: UInt8Array, **changes: object) -> DepthFrame:
    """A frame in which nothing is measured but for what `changes` say."""
    nowhere = np.zeros(labels.shape, np.bool_)
    full_labels = labels, CAMERA
    return frame(STAND, source, hours, **{"measured": nowhere, "full_labels": full_labels} | changes)


def felled(source: str, hours: float, cells: BoolArray = PATCH) -> DepthFrame:
    """Grass in place of these cells of the stand."""
    labels = np.where(shown(source) & ~shown(source, cells), Label.TREE, Label.GRASS)
    return labelled(source, hours, labels.astype(np.uint8))


def standing(source: str, hours: float, wrong: float = 0.0) -> DepthFrame:
    """Trees, but for the share `wrong` of the network's cells of 4 x 4 pixels, in which it sees grass."""
    labels = np.where(shown(source), Label.TREE, Label.GRASS).astype(np.uint8)
    rng = np.random.default_rng(len(source) + round(10 * hours))
    cells = rng.random((CAMERA.height // 4, CAMERA.width // 4)) < wrong
    labels[np.kron(cells, np.ones((4, 4), np.bool_))] = Label.GRASS
    return labelled(source, hours, labels)


def test_a_felled_stand_is_found_by_two_cameras() -> None:
    surface = stand_map()
    surface.add(felled("west", 0.0))
    surface.add(felled("east", 0.5))
    surface.decide()
    layers = surface.layers()
    seen = layers.observed & PATCH
    assert seen.sum() > 100
    assert (layers.change[seen] == ChangeKind.REMOVED).mean() > 0.9
    assert (layers.change[~PATCH] == ChangeKind.NONE).all()
    found = layers.change > 0
    assert np.abs(layers.height - BARE)[found].mean() < 0.1 * HEIGHT


def test_one_camera_alone_never_fells_it() -> None:
    """A network that takes this stand for grass does so all day."""
    surface = stand_map()
    for look in range(12):
        surface.add(felled("west", 2.0 * look))
    assert len(surface.decide().rows) == 0
    assert (surface.layers().observed & PATCH).sum() > 100


def test_a_stand_that_one_of_two_cameras_sees_stays() -> None:
    surface = stand_map()
    for look in range(4):
        surface.add(felled("west", 2.0 * look))
        surface.add(standing("east", 2.0 * look + 1))
    layers = surface.layers()
    surface.decide()
    assert (layers.observed & PATCH).sum() > 100
    assert (surface.layers().change == 0).all()


def test_a_standing_wood_stays_though_a_tenth_of_its_labels_are_wrong() -> None:
    surface = stand_map()
    wrong = 0.0
    for look in range(6):
        for camera in PLACES:
            seen = standing(camera, 2.0 * look, 0.1)
            assert seen.full_labels is not None
            wrong += float((seen.full_labels[0][shown(camera)] == Label.GRASS).mean()) / 12
            surface.add(seen)
    assert wrong == pytest.approx(0.1, abs=0.03)
    assert len(surface.decide().rows) == 0
    assert (surface.layers().observed & PATCH).sum() > 100


def test_sharp_depth_is_believed_against_labels() -> None:
    """Two cameras measure the stand to a decimetre; grass is seen in its place."""
    surface, whole = stand_map(), np.ones((CAMERA.height, CAMERA.width), np.bool_)
    for camera, hours in (("west", 0.0), ("east", 0.5)):
        surface.add(replace(felled(camera, hours), measured=whole, sigma=np.full(whole.shape, 0.1, np.float32)))
    assert len(surface.decide().rows) == 0
    assert (surface.layers().observed & PATCH).sum() > 100


def test_what_stands_before_a_stand_hides_it() -> None:
    """A network measures something at half the range, say a truck on a meadow: its label is not the stand's."""
    surface, whole = stand_map(), np.ones((CAMERA.height, CAMERA.width), np.bool_)
    for camera, hours in (("west", 0.0), ("east", 0.5)):
        seen = felled(camera, hours)
        near = 0.5 * seen.depth
        surface.add(replace(seen, measured=whole, depth=near, sigma=0.05 * near))
    surface.decide()
    assert not (surface.layers().change[PATCH] == ChangeKind.REMOVED).any()


def watched(camera: str, looks: int = 4) -> SurfaceMap:
    """A map that one camera has shown the stand standing, an hour apart."""
    surface = stand_map()
    for look in range(looks):
        surface.add(standing(camera, 1.0 * look))
    assert len(surface.decide().rows) == 0
    return surface


def test_a_camera_that_has_watched_the_stand_finds_it_felled_alone() -> None:
    camera = "east"
    surface = watched(camera)
    for hours in (30.0, 36.0, 42.0, 48.0):
        surface.add(felled(camera, hours))
        assert len(surface.decide().rows) == 0
    # The next day, as it may have been fog.
    surface.add(felled(camera, 52.0))
    surface.decide()
    layers = surface.layers()
    seen = layers.observed & PATCH
    assert (layers.change[seen] == ChangeKind.REMOVED).mean() > 0.9
    assert (layers.change[~PATCH] == ChangeKind.NONE).all()
    found = layers.change > 0
    assert np.abs(layers.height - BARE)[found].mean() < 0.1 * HEIGHT
    # It stands again: a stand that was lost to a mistake comes back.
    for hours in (60.0, 70.0, 81.0):
        surface.add(standing(camera, hours))
    surface.decide()
    assert (surface.layers().change[seen] == ChangeKind.REMOVED).mean() < 0.1
