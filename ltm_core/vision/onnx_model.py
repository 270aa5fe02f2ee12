"""Run ONNX networks on one image at a time, shared by the callers of one file.

A file may give labels and depth from one encoder, which takes most of its time. The first caller with an image runs all
outputs that callers of this process use; the others get theirs when they come with the same image."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.network_image import DTYPES, camera_feed, constant_tensor, image_feed, rows_of
from ltm_core.vision.onnx_file import NetworkFile

_Outputs = dict[str, npt.NDArray[Any]]
_Run = Callable[[list[str]], list[npt.NDArray[Any]]]

_PICTURES: Final = 4  # maximum number of cached images with pending outputs, one per camera in flight


class SharedRuns:
    """A file in memory and its runs, thread-safe; each output is given to one user, which may modify it."""

    def __init__(self, session: Any = None) -> None:
        self.session = session
        self._lock = threading.Lock()
        self._asked: WeakKeyDictionary[object, str] = WeakKeyDictionary()
        self._waiting: deque[tuple[npt.NDArray[Any], _Outputs]] = deque(maxlen=_PICTURES)

    def join(self, owner: object, output: str) -> None:
        """Register `owner` as a user of `output` while it exists."""
        with self._lock:
            self._asked[owner] = output

    def run(self, tensor: npt.NDArray[Any], outputs: Sequence[str], compute: _Run) -> list[npt.NDArray[Any]]:
        """Return outputs of an image's tensor, which must not change meanwhile; `compute` returns outputs by name."""
        with self._lock:
            others = [name for name in dict.fromkeys(self._asked.values()) if name not in outputs]
            for place, (of, parts) in enumerate(self._waiting):
                if all(name in parts for name in outputs) and np.array_equal(of, tensor):
                    found = [parts.pop(name) for name in outputs]
                    if not parts:
                        del self._waiting[place]
                    return found
        made = compute([*outputs, *others])
        if others:
            rest = dict(zip(others, made[len(outputs) :], strict=True))
            with self._lock:
                self._waiting.append((tensor.copy(), rest))
        return made[: len(outputs)]


_loaded: WeakValueDictionary[tuple[str, int, str], SharedRuns] = WeakValueDictionary()
_one_at_a_time = threading.Lock()

_FLOATS: Final = ("tensor(float)", "tensor(float16)", "tensor(double)")


class OnnxModel:
    """Network of a manifest; the checksum and tensors of its file are compared with the manifest.

    Several threads may run it at once. A file is in memory once a process, for all who open it with as many threads;
    what runs need meanwhile is given back to one heap of all networks. Where they ask it for different outputs, an
    image is run once for all of them (`SharedRuns`).

    Raises ModelError, with what was expected and what was found, when the file is absent, has another checksum,
    is not an ONNX network that the runtime can load, or has other inputs or outputs."""

    def __init__(self, manifest: NetworkManifest, threads: int = 1) -> None:
        self.manifest = manifest
        self.path = manifest.model_file()
        file = NetworkFile.read(self.path)
        if file.digest != manifest.sha256:
            weights = f" with {', '.join(file.weights)}" if file.weights else ""
            raise ModelError(
                f"model {manifest.name!r}: {self.path}{weights} has sha256 {file.digest}, expected {manifest.sha256}; "
                "download the file again, or update the checksum if you changed the network"
            )
        # Who opens the same file in this process gets the same session, which any number of threads may run.
        key = file.digest, threads, str(manifest.input.constants)
        with _one_at_a_time:
            loaded = _loaded.get(key)
            if loaded is None:
                loaded = _loaded[key] = SharedRuns(open_session(file, self.path, threads))
        self._loaded, self._session = loaded, loaded.session
        self._constants: dict[str, npt.NDArray[Any]] = {}
        self._camera: Any = None
        self._image = self._checked_inputs()
        self._output_name = self._checked_output()
        # A file with heads of labels and of depth computes only the one that is asked for.
        self._options = ort.RunOptions()
        self._options.only_execute_path_to_fetches = True
        loaded.join(self, self._output_name)

    def outputs(self, tensor: npt.NDArray[Any], matrix: Float64Array | None = None) -> list[npt.NDArray[Any]]:
        """Run the network, and return its output tensor and those that the manifest names beside it, in that order;
        float16 and float64 as float32. `matrix`: (3, 3) camera matrix in pixels of the input, for a manifest that names
        an input for it. Raises ModelError if the network needs it and it is missing."""
        names = [self._output_name, *self.manifest.output.beside]
        if self._camera is None:
            return self._shared(tensor, names)
        if matrix is None:
            raise self._wrong(f"input {self._camera.name!r}", "a camera matrix", "none")
        return self._run(names, self._feed(tensor) | camera_feed(self._camera, matrix, tensor, self.manifest.input))

    def run_with_maps(
        self, tensor: npt.NDArray[Any], maps: Sequence[str]
    ) -> tuple[npt.NDArray[Any], list[Float32Array]]:
        """Return the output tensor and the decoder maps (C, h, w) of these names; other users do not get such outputs.
        Raises ModelError for other maps."""
        output, *found = self._shared(tensor, [self._output_name, *maps])
        for name, values in zip(maps, found, strict=True):
            channels = self.manifest.maps.get(name)
            if values.ndim != 4 or values.dtype != np.float32 or values.shape[1] != channels:
                raise self._wrong(f"map {name!r}", f"float32 [1, {channels}, h, w]", f"{values.dtype} {values.shape}")
        return np.asarray(output), [np.ascontiguousarray(values[0], np.float32) for values in found]

    def _shared(self, tensor: npt.NDArray[Any], outputs: list[str]) -> list[Any]:
        return self._loaded.run(tensor, outputs, lambda names: self._run(names, self._feed(tensor)))

    def _feed(self, tensor: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        return image_feed(self._image, tensor, self._constants)

    def _run(self, outputs: list[str], feed: dict[str, npt.NDArray[Any]]) -> list[Any]:
        """Raise ModelError: some faults of a graph show where it runs alone, as a window larger than what it pools."""
        try:
            found = self._session.run(outputs, feed, self._options)
        except Exception as reason:  # of the runtime's errors, which have no common base
            raise ModelError(
                f"model {self.manifest.name!r} ({self.path}): ONNX Runtime {ort.__version__} cannot run it ({reason}); "
                "use the network that the manifest describes"
            ) from reason
        return [v.astype(np.float32) if v.dtype in (np.float16, np.float64) else v for v in map(np.asarray, found)]

    def _checked_inputs(self) -> Any:
        """Return the input node of the image, and keep those of the camera and the constants."""
        spec, nodes = self.manifest.input, {node.name: node for node in self._session.get_inputs()}
        if spec.intrinsics is not None:
            camera = nodes.pop(self._named(spec.intrinsics, list(nodes), "input for the camera"))
            numbers = [size for size in camera.shape if isinstance(size, int) and size != 1]
            rays = len(camera.shape) >= 3 and 3 in (camera.shape[1], camera.shape[-1])
            if camera.type not in _FLOATS or not (numbers in ([3, 3], [], [4]) or rays):
                expected = "floats [1, 3, 3] (K), [4] (fx, fy, cx, cy), [1] (focal length) or [1, 3, h, w] (rays)"
                raise self._wrong(f"input {camera.name!r}", expected, f"{camera.type} {camera.shape}")
            self._camera = camera
        for name, value in spec.constants.items():
            node = nodes.pop(self._named(name, list(nodes), "input with a constant"))
            self._constants[name] = constant_tensor(value, node, (spec.height, spec.width))
        name = self._named(spec.name, list(nodes), "input")
        if len(nodes) > 1:
            others = ", ".join(f"{node.name} {node.type} {node.shape}" for node in nodes.values() if node.name != name)
            raise self._wrong("inputs", "one image, input.intrinsics and input.constants", f"also {others}")
        node = nodes[name]
        if DTYPES.get(node.type) != np.dtype(spec.dtype):
            raise self._wrong(f"input {name!r}: type", spec.dtype, node.type)
        views = len(node.shape) == 5 and _fits(node.shape[1:2], (1,))
        shape = [node.shape[0], *node.shape[2:]] if views else node.shape
        if not _fits(shape, spec.shape):
            expected = f"{list(spec.shape)} ({spec.layout}, {spec.width} x {spec.height})"
            raise self._wrong(f"input {name!r}: shape", expected, node.shape)
        sides = shape[2:] if spec.layout == "NCHW" else shape[1:3]
        if spec.fit == "aspect" and any(isinstance(side, int) for side in sides):
            raise self._wrong("input.fit: aspect", "an input with free height and width (or fit: pad)", node.shape)
        return node

    def _checked_output(self) -> str:
        spec, nodes = self.manifest.output, {node.name: node for node in self._session.get_outputs()}
        name = self._named(spec.name, list(nodes), "output")
        for what, wanted in (("map", self.manifest.maps), ("output", spec.beside)):
            for each in wanted:
                self._named(each, list(nodes), what)
        node = nodes[name]
        shape, text, labels = node.shape, self.manifest.text, f"a float tensor of {spec.kind}"
        if spec.kind == "ids":
            labels, fits = "an integer tensor of class ids", node.type.startswith(("tensor(int", "tensor(uint"))
        else:
            fits = node.type in _FLOATS
        if not fits:
            raise self._wrong(f"output {name!r}: type", labels, node.type)
        count = len(self.manifest.classes) if text is None else text.dimensions
        if not shape:  # not stated: what comes out is checked
            return name
        if spec.kind == "ids":
            expected, fits = "[1, height, width]", len(shape) in (2, 3, 4)
        elif spec.is_depth:
            axes = [size for size in shape if size != 1]
            expected = "[1, h, w], one channel or 3-D points"
            fits = len(axes) < 3 or any(isinstance(size, str | None) or size == 3 for size in axes)
        elif spec.kind == "masks":
            expected, fits = "[1, queries, h, w]", len(shape) == 4
        else:
            allowed = (count, 1) if spec.kind == "probabilities" and count == 2 else (count,)
            if len(shape) == 3:  # tokens of a vision tower, or one run per class
                channels = shape[2] if text is not None else count if rows_of(self._constants) == count else None
            else:
                channels = shape[1 if spec.layout == "NCHW" else 3] if len(shape) == 4 else None
            what = "classes" if text is None else "dimensions of text.dimensions"
            axes_of = f"[1, {count}, h, w]" if spec.layout == "NCHW" else f"[1, h, w, {count}]"
            expected = f"{axes_of} ({spec.layout}, {count} {what})"
            fits = channels is not None and (not isinstance(channels, int) or channels in allowed)
        if not fits:
            raise self._wrong(f"output {name!r}: shape", expected, shape)
        return name

    def _named(self, wanted: str | None, present: list[str], what: str) -> str:
        if wanted is None and present:
            return present[0]
        if wanted is None or wanted not in present:
            expected = "one" if wanted is None else repr(wanted)
            raise self._wrong(what, expected, ", ".join(map(repr, present)) or "none")
        return wanted

    def _wrong(self, what: str, expected: object, found: object) -> ModelError:
        return ModelError(
            f"model {self.manifest.name!r} ({self.path}): {what}: expected {expected}, found {found}; "
            "correct the manifest, or use the network that it describes"
        )


@cache
def _share_arena() -> None:
    """Use one heap for the tensors within all networks of this process.

    Else each session keeps as much as its runs at once took, though a thread runs one network after the other. With the
    same blocks for all, and taken as each tensor comes instead of one block for a run, two networks of 640 x 352 keep
    124 MB with their weights instead of 253, and 184 instead of 367 where two threads run them, in the same time."""
    place = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    of_the_runtime = -1
    ort.create_and_register_allocator(place, ort.OrtArenaCfg(0, of_the_runtime, of_the_runtime, of_the_runtime))


def open_session(file: NetworkFile, path: Path, threads: int = 1) -> ort.InferenceSession:
    """Load the network of a file at `path`, whose external weights lie beside it. Raises ModelError. Callers of several
    threads hold a lock."""
    _share_arena()
    options = ort.SessionOptions()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.enable_mem_pattern = False
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    # Waiting threads sleep: a tower's cores are shared with the tracer and the camera driver.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        what = str(path) if file.weights else file.content
        return ort.InferenceSession(what, sess_options=options, providers=["CPUExecutionProvider"])
    # The runtime's errors have no common base but Exception; each of them means that this file cannot be run.
    except Exception as reason:
        found = f"{len(file.content)} bytes that ONNX Runtime {ort.__version__} rejects"
        raise ModelError(f"{path}: expected an ONNX network, found {found}: {reason}") from reason


def _fits(found: list[int | str | None], expected: tuple[int, ...]) -> bool:
    """Return whether a graph's shape (names and None are free axes) takes a tensor of the expected shape."""
    if len(found) != len(expected):
        return False
    return all(not isinstance(a, int) or a == b for a, b in zip(found, expected, strict=True))
