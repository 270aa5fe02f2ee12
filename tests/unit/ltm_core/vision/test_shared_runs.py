import gc
from array import array
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import yaml

from ltm_core.base.types import UInt8Array
from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest
from ltm_core.vision.network_image import shrunk
from ltm_core.vision.onnx_model import OnnxModel, SharedRuns


class _Asker:
    """Someone who lives as long as he is held."""


class _File:
    """Computes outputs that tell their picture, and notes what it was asked for."""

    def __init__(self, picture: float) -> None:
        self.tensor = np.full((2, 3), picture)
        self.runs: list[list[str]] = []

    def compute(self, names: list[str]) -> list[npt.NDArray[Any]]:
        self.runs.append(names)
        return [np.array([self.tensor[0, 0], ord(name[0])]) for name in names]


def _joined(*outputs: str) -> tuple[SharedRuns, list[_Asker]]:
    runs, askers = SharedRuns(), [_Asker() for _ in outputs]
    for asker, output in zip(askers, outputs, strict=True):
        runs.join(asker, output)
    return runs, askers


def test_a_picture_is_run_once_for_both() -> None:
    runs, askers = _joined("labels", "depth")
    file = _File(5.0)
    (labels,) = runs.run(file.tensor, ["labels"], file.compute)
    (depth,) = runs.run(file.tensor.copy(), ["depth"], file.compute)
    assert file.runs == [["labels", "depth"]]
    np.testing.assert_array_equal(labels, [5.0, ord("l")])
    np.testing.assert_array_equal(depth, [5.0, ord("d")])
    # A part is given out once: whoever has it may write to it.
    (again,) = runs.run(file.tensor, ["depth"], file.compute)
    assert again is not depth
    assert len(file.runs) == 2
    assert len(askers) == 2


def test_who_is_gone_or_alone_is_not_computed_for() -> None:
    runs, askers = _joined("labels", "depth", "labels")
    file = _File(5.0)
    del askers[1]
    gc.collect()
    runs.run(file.tensor, ["labels"], file.compute)
    assert file.runs == [["labels"]]


def test_what_nobody_takes_makes_room() -> None:
    runs, askers = _joined("labels", "depth")
    files = [_File(float(number)) for number in range(9)]
    for file in files:
        runs.run(file.tensor, ["labels"], file.compute)
    (depth,) = runs.run(files[0].tensor, ["depth"], files[0].compute)
    assert len(files[0].runs) == 2
    np.testing.assert_array_equal(depth, [0.0, ord("d")])
    runs.run(files[8].tensor, ["depth"], files[8].compute)
    assert len(files[8].runs) == 1
    assert len(askers) == 2


def test_labels_and_depth_of_one_file_are_the_same_alone_and_shared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    labels = NetworkManifest.find(DEFAULT_MODEL)
    path = tmp_path / "one_depth.yaml"
    output = {"name": "inverse_depth", "kind": "relative_inverse", "layout": "NCHW"}
    asked = {"name": "one_depth", "file": str(labels.model_file()), "output": output}
    kept = yaml.safe_load((labels.folder / f"{DEFAULT_MODEL}.yaml").read_text())
    content = {name: kept[name] for name in ("sha256", "licence", "card", "source", "input")} | asked
    path.write_text(yaml.safe_dump(content))
    depth = NetworkManifest.load(path)
    tensor = np.random.default_rng(3).normal(0, 1, labels.input.shape).astype(np.float32)
    # With as many threads as no other test of this process: whoever has the file open is computed for, too.
    alone = [OnnxModel(each, 3).outputs(tensor)[0] for each in (labels, depth)]
    runs: list[list[str]] = []
    run = OnnxModel._run
    monkeypatch.setattr(OnnxModel, "_run", lambda own, names, feed: runs.append(names) or run(own, names, feed))
    first, second = OnnxModel(labels, 3), OnnxModel(depth, 3)
    np.testing.assert_array_equal(first.outputs(tensor)[0], alone[0])
    np.testing.assert_array_equal(second.outputs(tensor.copy())[0], alone[1])
    assert runs == [["logits", "inverse_depth"]]


def test_nodes_that_get_one_image_reduce_it_once_while_it_exists() -> None:
    memory = array("B", bytes(range(48)))

    def photo() -> UInt8Array:
        pixels = np.frombuffer(memory, np.uint8).reshape(4, 4, 3)
        pixels.flags.writeable = False
        return pixels

    first = shrunk(photo(), 2, 2)
    np.testing.assert_array_equal(first[0, 0], (8, 9, 10))  # means of 0, 3, 12, 15 and so on, rounded
    assert shrunk(photo(), 2, 2) is first
    assert shrunk(photo(), 1, 1) is not first
    assert shrunk(photo()[::-1], 2, 2) is not first
    memory = array("B", bytes(48))
    assert not shrunk(photo(), 2, 2).any()


def test_an_image_that_may_change_is_reduced_each_time() -> None:
    pixels = np.zeros((4, 4, 3), np.uint8)
    shrunk(pixels, 2, 2)
    pixels += 7
    np.testing.assert_array_equal(shrunk(pixels, 2, 2), 7)
    fixed = np.frombuffer(bytes(48), np.uint8).reshape(4, 4, 3)  # of memory whose end cannot be noticed
    assert shrunk(fixed, 2, 2) is not shrunk(fixed, 2, 2)


@pytest.mark.parametrize("size", [(20, 12), (16, 9), (7, 5), (40, 24)])
def test_an_image_is_reduced_by_the_area_of_its_pixels(size: tuple[int, int]) -> None:
    photo = np.random.default_rng(5).integers(0, 256, (24, 40, 3), dtype=np.uint8)
    expected = cv2.resize(photo.astype(np.float64), size, interpolation=cv2.INTER_AREA)
    assert np.abs(shrunk(photo, *size) - expected).max() <= 0.5 + 1e-4
