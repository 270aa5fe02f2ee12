from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime as ort
import pytest
from onnx import TensorProto
from scenes.public_exports import ADE, EXPORTS, Graph, skips

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_core.depth.monocular import DepthNetwork, shift_of_points
from ltm_core.geometry.camera import Camera
from ltm_core.vision.install_io import install, source_of, stated_by
from ltm_core.vision.labels import Label
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.network_image import pixel_rays
from ltm_core.vision.recognition import recognise
from ltm_core.vision.segmenter import Segmenter

CAMERA = Camera(320, 180, 300.0, 290.0, 158.0, 93.0)


@pytest.fixture(autouse=True)
def data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path / "data" / "ltm" / "models"


def photo() -> UInt8Array:
    small = np.random.default_rng(2).integers(0, 256, (9, 16, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(small, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_CUBIC), np.uint8)


def added(given: Path | str, *options: str, like: str = "", name: str = "") -> NetworkManifest:
    with source_of(str(given)) as source:
        return install(recognise(source, stated_by(options), like, name), source)


def direct(manifest: NetworkManifest, matrix: Float64Array | None = None) -> tuple[dict[str, Any], int, int]:
    """Run the installed file by its own names; return its outputs, and the rows and columns that show the photo."""
    spec = manifest.input
    wide, tall = spec.width, spec.height
    if spec.fit == "aspect":
        ratio = (wide * tall / (CAMERA.width * CAMERA.height)) ** 0.5 / spec.multiple
        wide, tall = round(CAMERA.width * ratio) * spec.multiple, round(CAMERA.height * ratio) * spec.multiple
    cols, rows = wide, tall
    if spec.fit == "pad":
        ratio = min(wide / CAMERA.width, tall / CAMERA.height)
        cols, rows = round(CAMERA.width * ratio), round(CAMERA.height * ratio)
    shrinks = cols <= CAMERA.width and rows <= CAMERA.height
    small = cv2.resize(photo(), (cols, rows), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    whole = np.empty((tall, wide, 3))
    whole[:] = np.rint(np.array(spec.mean) / spec.scale)
    whole[:rows, :cols] = small
    tensor = ((whole * spec.scale - np.array(spec.mean)) / np.array(spec.std)).transpose(2, 0, 1)[None]
    session = ort.InferenceSession(str(manifest.model_file()), providers=["CPUExecutionProvider"])
    nodes = {node.name: node for node in session.get_inputs()}
    name = spec.name or next(iter(nodes))
    feed: dict[str, Any] = {name: tensor.astype(spec.dtype)}
    if len(nodes[name].shape) == 5:
        feed[name] = feed[name][:, None]
    for key, value in spec.constants.items():
        shape = [size if isinstance(size, int) else 1 for size in nodes[key].shape]
        given = np.ones((1, tall, wide), np.int64) if key == "pixel_mask" else np.reshape(np.array(value), (*shape,))
        feed[key] = given
    if spec.intrinsics is not None:
        k = np.diag([cols / CAMERA.width, rows / CAMERA.height, 1.0]) @ CAMERA.matrix
        k[0, 2], k[1, 2] = k[0, 2] + 0.5 * k[0, 0] / CAMERA.fx - 0.5, k[1, 2] + 0.5 * k[1, 1] / CAMERA.fy - 0.5
        u, v = np.meshgrid(np.arange(wide), np.arange(tall))
        rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones(u.shape)])
        rays /= np.linalg.norm(rays, axis=0)
        feed[spec.intrinsics] = (k if spec.intrinsics == "K" else rays)[None].astype(np.float32)
    names = [node.name for node in session.get_outputs()]
    found = {n: np.asarray(v).astype(np.float32) for n, v in zip(names, session.run(None, feed), strict=True)}
    return found | {"size": (tall, wide)}, rows, cols


def crop(planes: Float32Array, size: tuple[int, int], rows: int, cols: int) -> Float32Array:
    """The part of planes (K, h, w) that shows the photo, where its border is one of their pixels."""
    tall, wide = planes.shape[-2] * rows / size[0], planes.shape[-1] * cols / size[1]
    assert tall.is_integer()
    assert wide.is_integer()
    return planes[..., : int(tall), : int(wide)]


def plane(values: Any) -> Float32Array:
    """A depth or the third coordinate of 3-D points, (1, h, w)."""
    values = np.asarray(values)
    values = values[..., 2] if values.shape[-1] == 3 else values
    return np.asarray(values.reshape(-1, *values.shape[-2:])[-1:], np.float32)


def close(found: Float32Array, expected: Float32Array) -> None:
    # Reduced photos may differ by one grey level.
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=4e-3 * np.nanmax(np.abs(expected)))


SIGNATURES = {
    # folder: main output, and what turns it into the expected depth of a camera of horizontal focal length f (pixels
    # of the input) in an image of width w
    "metric3d_vit_small": ("pred_depth", lambda z, out, f, w: z * f / 1000),
    "metric3d_community": ("predicted_depth", lambda z, out, f, w: z * f / 1000),
    "unidepth_v2_cam": ("depth", lambda z, out, f, w: z),
    "unidepth_v2": ("pts_3d", lambda z, out, f, w: z),
    "unidepth_v2_rays": ("pts_3d", lambda z, out, f, w: z),
    "depth_pro_half": ("depth", lambda z, out, f, w: f / w / z),
    "depth_pro_ext": ("predicted_depth", lambda z, out, f, w: z),
    "depth_anything_v2_small": ("predicted_depth", lambda z, out, f, w: z),
}


@pytest.mark.parametrize("folder", SIGNATURES)
def test_depth_of_a_public_export_is_that_of_a_direct_run(shared_models: Path, folder: str) -> None:
    place = shared_models / "signatures" / folder
    options = ["normalise=imagenet", "output.kind=relative_inverse"] if folder == "depth_anything_v2_small" else []
    file = next(place.glob("*.onnx"))
    manifest = added(file, *options, name=folder)
    output, expected = SIGNATURES[folder]
    found, rows, cols = direct(manifest)
    focal = CAMERA.fx * cols / CAMERA.width
    values = DepthNetwork.open(folder).predict(photo(), CAMERA)
    points = found[output].reshape(-1, *found[output].shape[-2:])
    raw = crop(points[-1:], found["size"], rows, cols)[0]
    with np.errstate(divide="ignore"):
        depth = expected(raw, found, focal, found["size"][1])
    close(values.values, np.where(np.isfinite(depth), depth, np.nan))


def test_the_shift_of_points_is_found_from_rays() -> None:
    rng = np.random.default_rng(5)
    rays = pixel_rays(CAMERA.matrix, (18, 32))[:2]
    depth = rng.uniform(3.0, 40.0, (18, 32))
    points = np.concatenate([rays * depth, depth[None] - 1.75]).astype(np.float32)
    points[:, 0, :5] = np.nan
    assert shift_of_points(points, points[2], rays) == pytest.approx(1.75, rel=1e-4)


@pytest.mark.parametrize(
    ("export", "kind", "fit", "multiple"),
    [
        ("depth_anything_v2", "relative_inverse", "aspect", 14),
        ("depth_anything_v2_metric", "metric", "aspect", 14),
        ("depth_anything_v3", "affine_invariant", "aspect", 14),
        ("zoedepth", "metric", "aspect", 32),
    ],
)
def test_a_depth_network_of_a_hub_needs_no_options(
    tmp_path: Path, export: str, kind: str, fit: str, multiple: int
) -> None:
    EXPORTS[export](tmp_path / export)
    file = next((tmp_path / export).rglob("*.onnx"))
    manifest = added(file if file.name != "model.onnx" else tmp_path / export)
    assert manifest.name == export
    assert (manifest.output.kind, manifest.input.fit, manifest.input.multiple) == (kind, fit, multiple)
    found, rows, cols = direct(manifest)
    expected = plane(found["predicted_depth"])
    close(DepthNetwork.open(export).predict(photo(), CAMERA).values, crop(expected, found["size"], rows, cols)[0])


@pytest.mark.parametrize("export", ["segformer", "mask2former", "eomt", "oneformer"])
def test_a_label_network_of_a_hub_needs_no_options(tmp_path: Path, export: str) -> None:
    EXPORTS[export](tmp_path / export)
    manifest = added(tmp_path / export)
    assert manifest.classes[1:4] == ("building, edifice", "sky", "tree")
    expected_labels = {"wall": "built", "building, edifice": "built", "sky": "sky", "tree": "tree", "grass": "grass"}
    assert manifest.mapping == expected_labels | {"earth, ground": "bare"}
    found, rows, cols = direct(manifest)
    if export == "segformer":
        assert (manifest.output.kind, manifest.input.fit, manifest.input.multiple) == ("logits", "aspect", 4)
        scores = found["logits"][0]
    else:
        assert manifest.output.kind == "masks"
        logits = found["class_queries_logits"][0].astype(float)
        weight = np.exp(logits - logits.max(axis=1, keepdims=True))
        weight = weight[:, :-1] / weight.sum(axis=1, keepdims=True)
        scores = np.einsum("qk,qhw->khw", weight, 1 / (1 + np.exp(-found["masks_queries_logits"][0].astype(float))))
    segmenter = Segmenter.open(export)
    close(segmenter.logits(photo()), crop(scores, found["size"], rows, cols))
    assert set(np.unique(segmenter.segment(photo()).labels)) <= {*map(int, Label), 255}
    total = sum(segmenter.class_probabilities(photo()).values())
    assert np.all(total <= 1 + 1e-5)


def test_sizes_and_probabilities_are_determined_by_running(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    manifest = added(skips(tmp_path), "normalise=unit", f"classes={list(ADE.values())}", name="skips")
    assert (manifest.input.multiple, manifest.output.kind) == (16, "probabilities")
    assert (manifest.input.width, manifest.input.height) == (640, 352)
    assert not capfd.readouterr().err
    found, _, _ = direct(manifest)
    close(Segmenter.open("skips").logits(photo()), found["output"][0])


@pytest.mark.parametrize(("export", "leading"), [("siglip", 0), ("dinov3_text", 5), ("lseg", None)])
def test_dense_embeddings_are_compared_with_words(tmp_path: Path, export: str, leading: int | None) -> None:
    file = EXPORTS[export](tmp_path / export)
    words, given = tmp_path / export / "words.npz", "normalise=half"
    with pytest.raises(ModelError, match=r"text\.file"):
        added(file, given)
    manifest = added(file, f"text.file={words}", given, "mapping={grass: grass, oak: tree, sky: sky}", name=export)
    square = np.ascontiguousarray(photo()[:, :180])
    small = cv2.resize(square, (64, 64), interpolation=cv2.INTER_AREA)
    session = ort.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    (found,) = session.run(None, {manifest.input.name: (small.transpose(2, 0, 1)[None] / 127.5 - 1).astype(np.float32)})
    dense = found[0] if leading is None else found[0, leading:].T.reshape(-1, 4, 4)
    vectors = np.load(words)["embeddings"]
    vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    expected = 100 * np.einsum("kd,dhw->khw", vectors, dense / np.linalg.norm(dense, axis=0))
    close(Segmenter.open(export).logits(square), expected)
    wide = Segmenter.open(export).logits(photo())  # 36 of 64 rows of the network's image show it
    assert wide.shape[1:] == ((18, 32) if leading is None else (2, 4))


@pytest.mark.parametrize(
    ("make", "options", "named"),
    [
        ("segformer", ["input.width=five"], "width"),
        ("segformer", ["output.name=scores"], "scores"),
        ("segformer", ["input.constants.task=3"], "task"),
        ("segformer", ["normalise=caffe"], "caffe"),
        ("segformer", ["input.constants.pixel_values=[[1, 2], [3]]"], "inhomogeneous"),
        ("segformer", ["colour=red"], "colour"),
        ("segformer", ["input=5"], "input"),
        ("zoedepth", ["classes=[sky]"], "classes"),
        ("depth_anything_v3", ["sha256=" + "ab" * 32], "ab" * 32),
    ],
)
def test_a_rejected_network_leaves_nothing(
    tmp_path: Path, data_folder: Path, make: str, options: list[str], named: str
) -> None:
    EXPORTS[make](tmp_path / make)
    with pytest.raises(ModelError, match=named):
        added(tmp_path / make, *options)
    assert not data_folder.exists()


def _depth_graph(path: Path, camera: tuple[str, list[int]] | None = None, **changes: Any) -> Path:
    """A depth of green / 255 + 1, times the largest value of the input for the camera; `changes` of its last steps."""
    graph = Graph("image", [changes.get("images", 1), 3, 32, 48], 1, 1)
    planes = graph.add("Conv", ["image", graph.constant(np.array([0, 1, 0], np.float32).reshape(1, 3, 1, 1))])
    depth = graph.add("Add", [planes, graph.constant(np.float32(changes.get("offset", 1.0)))])
    if camera is not None:
        given = graph.takes(camera[0], TensorProto.FLOAT, camera[1])
        depth = graph.add("Mul", [depth, graph.add("ReduceMax", [given], keepdims=0)])
    element, shape = TensorProto.FLOAT, [changes.get("images", 1), 1, 32, 48]
    if changes.get("points"):
        depth = graph.add("Transpose", [graph.add("Concat", [planes, planes, depth], axis=1)], perm=[0, 2, 3, 1])
        shape = [1, 32, 48, 3]
    if changes.get("double"):
        element, depth = TensorProto.DOUBLE, graph.add("Cast", [depth], to=TensorProto.DOUBLE)
    if changes.get("logarithm"):
        depth = graph.add("Log", [depth])
    graph.gives("depth", depth, shape if changes.get("rank", True) else None, element)
    return graph.write(path)


FX = 48 / 320 * 300


@pytest.mark.parametrize(
    ("camera", "largest"),
    [
        (("K", [1, 3, 3]), FX),
        (("K", [3, 3]), FX),
        (("intrinsics", [1, 4]), FX),
        (("focal_length", [1]), FX),
        (("rays", [1, 3, 32, 48]), 1.0),
    ],
)
def test_each_form_of_a_camera_input_gets_the_camera_of_the_networks_pixels(
    tmp_path: Path, camera: tuple[str, list[int]], largest: float
) -> None:
    manifest = added(_depth_graph(tmp_path / "net.onnx", camera), "normalise=unit", name="net")
    assert (manifest.output.kind, manifest.input.intrinsics, manifest.input.fit) == ("metric", camera[0], "pad")
    values = DepthNetwork.open("net").predict(np.full((180, 320, 3), 102, np.uint8), CAMERA).values
    assert values.shape == (27, 48)
    np.testing.assert_allclose(values, 1.4 * largest, rtol=2e-3)


@pytest.mark.parametrize(
    ("name", "value", "assumed"),
    [
        ("focallength_px", 777.0, 777.0),
        ("fov", 50.0, 24 / np.tan(np.radians(25))),
        ("fov_rad", np.radians(50), 24 / np.tan(np.radians(25))),
    ],
)
def test_metres_follow_the_focal_length_that_the_network_assumed(
    tmp_path: Path, name: str, value: float, assumed: float
) -> None:
    graph = Graph("pixel_values", [1, 3, 48, 48], 1, 1)
    zero = graph.add("Mul", [graph.features, graph.constant(np.float32(0.0))])
    graph.gives("predicted_depth", graph.add("Add", [zero, graph.constant(np.float32(2.0))]), [1, 1, 48, 48])
    pooled = graph.add("GlobalAveragePool", [zero])
    graph.gives(name, graph.add("Add", [pooled, graph.constant(np.float32(value))]), [1, 1, 1, 1])
    options = [] if name == "focallength_px" else ["normalise=half", "output.kind=metric", "input.fit=stretch"]
    manifest = added(graph.write(tmp_path / "net.onnx"), *options, name="net")  # Depth Pro is known by its outputs
    assert (manifest.output.kind, manifest.output.focal, manifest.input.fit) == ("metric", name, "stretch")
    values = DepthNetwork.open("net").predict(photo(), CAMERA).values
    np.testing.assert_allclose(values, 2.0 * (48 / 320 * 300) / assumed, rtol=1e-5)


def test_metres_follow_the_focal_length_that_a_network_was_made_for(tmp_path: Path) -> None:
    options = "normalise=unit", "output.kind=metric", "output.canonical_focal_px=10"
    added(_depth_graph(tmp_path / "net.onnx"), *options, name="net")
    values = DepthNetwork.open("net").predict(np.full((180, 320, 3), 102, np.uint8), CAMERA).values
    np.testing.assert_allclose(values, 1.4 * FX / 10, rtol=1e-5)


@pytest.mark.parametrize("changes", [{"points": True}, {"double": True}, {"rank": False}])
def test_other_forms_of_a_depth_output_run(tmp_path: Path, changes: dict[str, Any]) -> None:
    added(_depth_graph(tmp_path / "net.onnx", **changes), "normalise=unit", "output.kind=metric", name="net")
    values = DepthNetwork.open("net").predict(np.full((180, 320, 3), 102, np.uint8), CAMERA).values
    np.testing.assert_allclose(values, 1.4, rtol=1e-5)


@pytest.mark.parametrize(
    ("changes", "options", "name", "message"),
    [
        ({"images": 8}, [], "net", r"8 images"),
        ({}, [], "../evil", r"\.\./evil"),
        ({}, [], "net_fusion", r"net_fusion"),
        ({}, ["output.kind=disparity"], "net", r"disparity"),
        ({}, ["output.kind=logits"], "net", r"classes=\["),
        ({}, ["input.layout=NHWC"], "net", r"Expected: 48"),
    ],
)
def test_what_cannot_be_a_network_of_ours_is_rejected(
    tmp_path: Path, data_folder: Path, changes: dict[str, Any], options: list[str], name: str, message: str
) -> None:
    file = _depth_graph(tmp_path / "net.onnx", **changes)
    with pytest.raises(ModelError, match=message):
        added(file, "normalise=unit", "output.kind=metric", *options, name=name)
    assert not data_folder.exists()
