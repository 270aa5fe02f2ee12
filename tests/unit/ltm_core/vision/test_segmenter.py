from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes.networks import COLORS, changed, write_classifier

from ltm_core.base.errors import ModelError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.network_image import InputSpec, as_tensor
from ltm_core.vision.resampling import upsampled_winner
from ltm_core.vision.segmenter import Segmentation, Segmenter

SIZE = (110, 170)  # of the photos: no multiple of the network's size


def _photo(size: tuple[int, int] = SIZE) -> tuple[UInt8Array, UInt8Array]:
    """Blue above, below it red at the left and lime at the right, a white patch in a corner; and its labels."""
    height, width = size
    photo = np.empty((height, width, 3), np.uint8)
    labels = np.empty((height, width), np.uint8)
    row, col = int(height * 0.4), int(width * 0.3)
    for area, color, label in (
        (np.s_[:row], "blue", Label.SKY),
        (np.s_[row:, :col], "red", Label.BUILT),
        (np.s_[row:, col:], "lime", Label.GRASS),
        (np.s_[-row // 2 :, -col // 2 :], "white", UNLABELLED),
    ):
        photo[area] = COLORS[color]
        labels[area] = label
    return photo, labels


def _away_from_edges(labels: UInt8Array, pixels: int) -> BoolArray:
    kernel = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
    return np.asarray(cv2.dilate(labels, kernel) == cv2.erode(labels, kernel))


@pytest.mark.parametrize("kind", ["logits", "probabilities", "ids"])
@pytest.mark.parametrize(("layout", "dtype"), [("NCHW", "float32"), ("NHWC", "uint8"), ("NHWC", "float32")])
def test_every_kind_of_network_labels_the_photo(tmp_path: Path, kind: str, layout: str, dtype: str) -> None:
    segmenter = Segmenter.open(write_classifier(tmp_path, kind, layout, dtype))
    photo, truth = _photo()
    result = segmenter.segment(photo)
    assert result.labels.shape == result.confidence.shape == SIZE
    assert result.labels.dtype == result.confidence.dtype == np.uint8
    sure = _away_from_edges(truth, 6)
    assert sure.mean() > 0.5
    np.testing.assert_array_equal(result.labels[sure], truth[sure])
    assert (result.labels != truth).mean() < 0.04
    assert np.all(result.confidence[result.labels == UNLABELLED] == 0)
    assert np.all(result.confidence[result.labels != UNLABELLED] > 0)


def test_channel_order_follows_the_manifest(tmp_path: Path) -> None:
    photo, truth = _photo()
    segmenter = Segmenter.open(write_classifier(tmp_path, channels="bgr"))
    assert (segmenter.segment(photo).labels == truth).mean() > 0.96
    swapped = Segmenter.open(changed(tmp_path / "colors.yaml", input={"channels": "rgb"}))
    labels = swapped.segment(photo).labels
    assert np.all(labels[:20] == Label.BUILT)


@pytest.mark.parametrize("kind", ["logits", "ids"])
@pytest.mark.parametrize("size", [(110, 170), (170, 110), (90, 400), (31, 47)])
def test_padding_keeps_each_pixel_in_its_place(tmp_path: Path, kind: str, size: tuple[int, int]) -> None:
    path = write_classifier(tmp_path, kind, channels="bgr")
    photo, truth = _photo(size)
    labels = Segmenter.open(changed(path, input={"fit": "pad"})).segment(photo).labels
    sure = _away_from_edges(truth, round(max(size) / 48 * 2) + 2)
    assert sure.mean() > 0.3
    assert (labels[sure] == truth[sure]).mean() > 0.985


def test_a_network_of_any_size_gets_the_photos_aspect_ratio(tmp_path: Path) -> None:
    path = write_classifier(tmp_path, any_size=True)
    photo, truth = _photo((180, 90))
    segmenter = Segmenter.open(changed(path, input={"fit": "aspect", "multiple": 8}))
    assert segmenter.logits(photo).shape[1:] == (28, 12)  # 56 x 24 pixels, the area of 48 x 32
    assert (segmenter.segment(photo).labels == truth).mean() > 0.93
    with pytest.raises(ModelError, match=r"aspect.*48"):
        Segmenter.open(changed(write_classifier(tmp_path), input={"fit": "aspect"}))


def test_confidence_is_the_probability_of_the_label(tmp_path: Path) -> None:
    """One grey tone everywhere: the classes' softmax is known, and two classes of one label add up."""
    gain = 3.0
    grey = np.array([90, 160, 70], np.uint8)
    photo = np.broadcast_to(grey, (50, 70, 3)).copy()
    distance = ((np.array(list(COLORS.values())) - grey.astype(float)) / 255.0) ** 2
    probability = np.exp(-gain * distance.sum(axis=1))
    probability /= probability.sum()
    names = list(COLORS)
    grass = probability[names.index("lime")] + probability[names.index("olive")]
    assert grass < 0.9  # else the test could not tell a sum from a winner
    result = Segmenter.open(write_classifier(tmp_path, gain=gain)).segment(photo)
    assert np.all(result.labels == Label.GRASS)
    np.testing.assert_allclose(result.confidence, 255 * grass, atol=0.6)


def test_an_offset_is_added_to_its_classes_logits_alone(tmp_path: Path) -> None:
    """Its scores move by it and no others; a label whose classes are held down gives way."""
    photo = np.full((40, 60, 3), (140, 120, 60), np.uint8)
    path = write_classifier(tmp_path, gain=3.0)
    plain = Segmenter.open(path)
    scores = plain.logits(photo)
    order = np.argsort(scores[:, 5, 5])
    best = plain.classes[order[-1]]
    assert best in ("lime", "olive")
    moved = Segmenter.open(changed(path, output={"offsets": {best: -0.75}})).logits(photo)
    expected = scores.copy()
    expected[order[-1]] -= 0.75
    np.testing.assert_allclose(moved, expected, atol=1e-6)
    others = changed(path, output={"offsets": {"lime": -9.0, "olive": -9.0}})
    assert np.all(plain.segment(photo).labels == Label.GRASS)
    assert not np.any(Segmenter.open(others).segment(photo).labels == Label.GRASS)


def test_a_class_that_is_green_loses_where_the_photo_is_red(tmp_path: Path) -> None:
    """Nothing where green leads by 1 % of both, all from 3 % of red on, half between; other classes keep theirs."""
    photo = np.empty((40, 90, 3), np.uint8)
    photo[:, :30], photo[:, 30:60], photo[:, 60:] = (98, 102, 60), (103, 101, 60), (120, 100, 60)
    path = write_classifier(tmp_path, gain=3.0)
    plain = Segmenter.open(path).logits(photo)
    moved = Segmenter.open(changed(path, output={"redness": {"lime": 1.5}})).logits(photo)
    lime = Segmenter.open(path).classes.index("lime")
    taken = plain - moved
    rows, cols = taken.shape[1:]
    middle, third = rows // 2, cols // 3
    at = [third // 2, third + third // 2, 2 * third + third // 2]
    half = 1.5 * ((103 - 101) / (103 + 101 + 4) + 0.01) / 0.04
    np.testing.assert_allclose(taken[lime, middle, at], (0.0, half, 1.5), atol=1e-3)
    assert np.all(np.delete(taken, lime, axis=0) == 0)


def test_normalisation_follows_the_manifest() -> None:
    spec = InputSpec(
        width=5, height=3, layout="NCHW", dtype="float32", channels="bgr", scale=0.5, mean=(1, 2, 3), std=(2, 4, 8)
    )
    photo = np.random.default_rng(3).integers(0, 256, (3, 5, 3), dtype=np.uint8)
    tensor = as_tensor(photo, spec)
    assert tensor.shape == (1, 3, 3, 5)
    assert tensor.dtype == np.float32
    expected = (photo[2, 4, ::-1] * 0.5 - np.array([1, 2, 3])) / np.array([2, 4, 8])
    np.testing.assert_allclose(tensor[0, :, 2, 4], expected, rtol=1e-6)


def test_cameras_of_one_process_run_one_network_at_once(tmp_path: Path) -> None:
    """Each with a segmenter of its own, over the same file, from threads of their own."""
    manifest = write_classifier(tmp_path)
    photos = [np.roll(_photo()[0], 11 * turn, axis=1) for turn in range(4)]
    expected = [Segmenter.open(manifest).segment(photo) for photo in photos]
    segmenters = [Segmenter.open(manifest) for _ in photos]

    def label(at: int) -> list[Segmentation]:
        return [segmenters[at].segment(photos[at]) for _ in range(8)]

    with ThreadPoolExecutor(len(photos)) as pool:
        for alone, several in zip(expected, pool.map(label, range(len(photos))), strict=True):
            for found in several:
                np.testing.assert_array_equal(found.labels, alone.labels)
                np.testing.assert_array_equal(found.confidence, alone.confidence)


@pytest.mark.parametrize(
    ("rows", "cols", "height", "width"), [(9, 13, 54, 91), (16, 24, 31, 65), (1, 7, 5, 20), (12, 1, 40, 3)]
)
def test_upsampling_agrees_with_opencv(rows: int, cols: int, height: int, width: int) -> None:
    rng = np.random.default_rng(rows * cols)
    # Of some rows a class has so little that it can win nowhere in them; the first among them.
    share = [0.2, 3.0, 3.0, 0.5] if cols % 2 else [1.0, 1.0, 1.0, 1.0]
    probabilities = rng.dirichlet(share, size=(rows, cols)).astype(np.float32).transpose(2, 0, 1)
    winner, confidence = upsampled_winner(probabilities, height, width)
    planes = np.stack([cv2.resize(plane, (width, height), interpolation=cv2.INTER_LINEAR) for plane in probabilities])
    ordered = np.sort(planes, axis=0)
    clear = ordered[-1] - ordered[-2] > 1e-5
    assert clear.mean() > 0.95
    np.testing.assert_array_equal(winner[clear], planes.argmax(axis=0)[clear])
    np.testing.assert_allclose(confidence, planes.max(axis=0) * 255, atol=0.51)


def test_logits_declared_as_probabilities_are_refused(tmp_path: Path) -> None:
    segmenter = Segmenter.open(changed(write_classifier(tmp_path), output={"kind": "probabilities"}))
    with pytest.raises(ModelError, match=r"kind: logits"):
        segmenter.segment(_photo()[0])
