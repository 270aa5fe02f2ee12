import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import helper
from scenes.networks import changed, write_classifier

from ltm_core.base.errors import ModelError
from ltm_core.vision.manifest import MODEL_PATH_VARIABLE, NetworkManifest, shipped_names
from ltm_core.vision.onnx_model import OnnxModel


@pytest.fixture
def manifest_path(tmp_path: Path) -> Path:
    return write_classifier(tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colour": "red"}, r"colour: unknown key"),
        ({"input": {"widht": 3}}, r"input\.widht: unknown key"),
        ({"input": {"width": 0}}, r"input\.width"),
        ({"input": {"std": [1, 0, 1]}}, r"input\.std\.1: .*greater than 0"),
        ({"input": {"dtype": "uint8"}}, r"input: .*scale, mean and std"),
        ({"output": {"kind": "scores"}}, r"output\.kind.*'logits'.*'relative_inverse'"),
        ({"sha256": "12"}, r"sha256"),
        ({"classes": ["blue", "red", "blue"]}, r"classes has blue more than once"),
        ({"mapping": {"purple": "sky"}}, r"mapping names purple, not among classes \(blue, red"),
        ({"classes": []}, r"classes: missing; output kind logits needs it"),
        ({"mapping": {}}, r"mapping: missing; output kind logits needs it"),
        ({"output": {"kind": "relative_inverse"}}, r"classes and mapping belong to labels"),
        ({"output": {"inverse": True}}, r"output: .*inverse .*metric"),
        ({"output": {"canonical_focal_px": 700.0}}, r"output: .*canonical_focal_px .*metric.*logits"),
        ({"output": {"kind": "ids", "offsets": {"red": 1.0}}}, r"output: .*offsets .*logits"),
        ({"output": {"offsets": {"mauve": 1.0}}}, r"output\.offsets names mauve"),
    ],
)
def test_a_wrong_manifest_is_refused_by_the_key_at_fault(
    manifest_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        NetworkManifest.load(changed(manifest_path, **changes))
    assert str(manifest_path) in str(caught.value)


def test_an_unknown_name_lists_the_models_that_ship() -> None:
    assert "mosaic_r4_ade20k31" in shipped_names()
    with pytest.raises(ModelError, match=r"'spline'.*mosaic_r4_ade20k31"):
        NetworkManifest.find("spline")


def test_a_network_that_takes_heads_of_another_leaves_cameras_with_a_head_to_it() -> None:
    for suffix in ("", "_depth"):
        network, taught = (
            NetworkManifest.find(f"landscape_v5{suffix}"),
            NetworkManifest.find(f"landscape_lite0{suffix}"),
        )
        assert network.serving("landscape") is network
        assert network.serving("near").sha256 == network.serving("auto").sha256 == taught.sha256 != network.sha256
        assert taught.serving("near") is taught


def test_every_shipped_manifest_loads_and_has_its_card() -> None:
    for name in shipped_names():
        manifest = NetworkManifest.find(name)
        assert manifest.name == name
        assert (manifest.folder / manifest.card).is_file()


def test_the_file_is_found_beside_the_manifest_before_the_model_path(
    manifest_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "colors.onnx").write_bytes(b"another")
    monkeypatch.setenv(MODEL_PATH_VARIABLE, str(other))
    manifest = NetworkManifest.load(manifest_path)
    assert manifest.model_file() == tmp_path / "colors.onnx"
    (tmp_path / "colors.onnx").unlink()
    assert manifest.model_file() == other / "colors.onnx"


def test_a_changed_file_is_refused_with_both_checksums(manifest_path: Path, tmp_path: Path) -> None:
    manifest = NetworkManifest.load(manifest_path)
    network = tmp_path / "colors.onnx"
    network.write_bytes(network.read_bytes() + b"\0")
    with pytest.raises(ModelError, match=rf"sha256 [0-9a-f]{{64}}, expected {manifest.sha256}"):
        OnnxModel(manifest)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"input": {"width": 64}},
            r"input 'image': shape: expected \[1, 3, 32, 64\] \(NCHW, 64 x 32\), found \[1, 3, 32, 48\]",
        ),
        ({"input": {"layout": "NHWC"}}, r"expected \[1, 32, 48, 3\].*found \[1, 3, 32, 48\]"),
        ({"input": {"dtype": "uint8", "scale": 1.0}}, r"type: expected uint8, found tensor\(float\)"),
        ({"input": {"name": "photo"}}, r"input: expected 'photo', found 'image'"),
        ({"output": {"name": "probs"}}, r"output: expected 'probs', found 'scores'"),
        ({"output": {"kind": "ids"}}, r"expected an integer tensor of class ids, found tensor\(float\)"),
        (
            {"classes": ["blue", "red", "lime", "olive", "white", "sixth"]},
            r"expected \[1, 6, h, w\] \(NCHW, 6 classes\), found \[1, 5, 16, 24\]",
        ),
        ({"output": {"layout": "NHWC"}}, r"expected \[1, h, w, 5\] \(NHWC, 5 classes\), found \[1, 5, 16, 24\]"),
    ],
)
def test_a_network_unlike_its_manifest_is_refused_with_expected_and_found(
    manifest_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        OnnxModel(NetworkManifest.load(changed(manifest_path, **changes)))


def test_a_network_that_fails_as_it_runs_is_an_error_of_ours(manifest_path: Path, tmp_path: Path) -> None:
    """Its pooling window is larger than the picture: the runtime loads it."""
    network = onnx.load(str(tmp_path / "colors.onnx"))
    (pool,) = (node for node in network.graph.node if node.op_type == "AveragePool")
    del pool.attribute[:]
    pool.attribute.extend([helper.make_attribute("kernel_shape", [64, 2]), helper.make_attribute("strides", [2, 2])])
    content = network.SerializeToString()
    (tmp_path / "colors.onnx").write_bytes(content)
    model = OnnxModel(NetworkManifest.load(changed(manifest_path, sha256=hashlib.sha256(content).hexdigest())))
    with pytest.raises(ModelError, match=r"(?s)colors\.onnx\): ONNX Runtime .* cannot run it .*; use the network that"):
        model.outputs(np.zeros((1, 3, 32, 48), np.float32))
