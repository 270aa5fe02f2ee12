"""Run ONNX networks on one image at a time, shared by the callers of one file.

Runs of one network file that several ask for: what one of them computes for the others is kept until they come.

A file may answer labels and depth from one encoder, which is most of its work. Whoever asks first for an image has all
of it computed that others in this process ask this file for; they take their part when they bring the same image.
"""

from __future__ import annotations

import hashlib
import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final
from weakref import WeakKeyDictionary, WeakValueDictionary

import cv2
import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.vision.manifest import InputSpec, NetworkManifest

_Outputs = dict[str, npt.NDArray[Any]]
_Run = Callable[[list[str]], list[npt.NDArray[Any]]]

_PICTURES: Final = 4
"""Maximum number of cached images whose other outputs are pending, one per camera in flight; the oldest unused one is
dropped."""


class SharedRuns:
    """Shared runs of one file, thread-safe; each output is given to one user, which may modify it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked: WeakKeyDictionary[object, str] = WeakKeyDictionary()
        self._waiting: deque[tuple[npt.NDArray[Any], _Outputs]] = deque(maxlen=_PICTURES)

    def join(self, owner: object, output: str) -> None:
        """Register `owner` as a user of `output` while it exists."""
        with self._lock:
            self._asked[owner] = output

    def run(self, tensor: npt.NDArray[Any], outputs: Sequence[str], compute: _Run) -> list[npt.NDArray[Any]]:
        """Return these outputs of an image's tensor, which must not change meanwhile; `compute` returns outputs by
        name."""
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


_loaded: WeakValueDictionary[tuple[str, int], _Loaded] = WeakValueDictionary()
_one_at_a_time = threading.Lock()

_ELEMENT_TYPES = {"float32": "tensor(float)", "uint8": "tensor(uint8)"}


class _Loaded:
    """A file in memory."""

    def __init__(self, session: ort.InferenceSession) -> None:
        self.session, self.runs = session, SharedRuns()


class OnnxModel:
    """Network of a manifest; the checksum and tensors of its file are compared with the manifest.

    Several threads may run it at once. A file is in memory once a process, for all who open it with as many threads;
    what runs need meanwhile is given back to one heap of all networks. Where they ask it for different outputs, a
    image is run once for all of them (`shared_runs`).

    Raises ModelError, with what was expected and what was found, when the file is absent, has another checksum,
    is not an ONNX network that the runtime can load, or has other inputs or outputs.
    """

    def __init__(self, manifest: NetworkManifest, threads: int = 1) -> None:
        self.manifest = manifest
        self.path = manifest.model_file()
        content = self.path.read_bytes()
        found = hashlib.sha256(content).hexdigest()
        if found != manifest.sha256:
            raise ModelError(
                f"model {manifest.name!r}: {self.path} has sha256 {found}, expected {manifest.sha256}; "
                "download the file again, or update the checksum if you changed the network"
            )
        # Who opens the same file in this process gets the same session, which any number of threads may run.
        with _one_at_a_time:
            loaded = _loaded.get((found, threads))
            if loaded is None:
                loaded = _loaded[found, threads] = _Loaded(_session(content, self.path, threads))
        self._loaded, self._session = loaded, loaded.session
        self._input_name = self._checked_input()
        self._output_name = self._checked_output()
        # A file with heads of labels and of depth computes only the one that is asked for.
        self._options = ort.RunOptions()
        self._options.only_execute_path_to_fetches = True
        loaded.runs.join(self, self._output_name)

    def run(self, tensor: npt.NDArray[Any], intrinsics: Float32Array | None = None) -> npt.NDArray[Any]:
        """Run the network on a tensor of the manifest's input shape and dtype; gives its output tensor.

        `intrinsics`: (3, 3) camera matrix in pixels of the input, for a manifest that names an input for it. Raises
        ModelError where the network needs it and it is not given.
        """
        feed = {self._input_name: tensor}
        if (name := self.manifest.input.intrinsics) is not None:
            if intrinsics is None:
                raise self._wrong(f"input {name!r}", "a camera matrix", "none")
            feed[name] = np.ascontiguousarray(intrinsics, np.float32)[None]
            (output,) = self._run([self._output_name], feed)
        else:
            (output,) = self._shared(tensor, [self._output_name])
        return np.asarray(output)

    def run_with_maps(
        self, tensor: npt.NDArray[Any], maps: Sequence[str], part: bool = False
    ) -> tuple[npt.NDArray[Any], list[Float32Array]]:
        """Run as `run`, with the decoder maps (C, h, w) of these names; other users do not get such outputs.

        `part`: of an image, or another size of it, which no other user requests. Raises ModelError where the file
        gives something else by such a name.
        """
        names = [self._output_name, *maps]
        output, *found = self._run(names, {self._input_name: tensor}) if part else self._shared(tensor, names)
        for name, values in zip(maps, found, strict=True):
            channels = self.manifest.maps.get(name)
            if values.ndim != 4 or values.dtype != np.float32 or values.shape[1] != channels:
                raise self._wrong(f"map {name!r}", f"float32 [1, {channels}, h, w]", f"{values.dtype} {values.shape}")
        return np.asarray(output), [np.ascontiguousarray(values[0], np.float32) for values in found]

    def _shared(self, tensor: npt.NDArray[Any], outputs: list[str]) -> list[Any]:
        return self._loaded.runs.run(tensor, outputs, lambda names: self._run(names, {self._input_name: tensor}))

    def _run(self, outputs: list[str], feed: dict[str, npt.NDArray[Any]]) -> list[Any]:
        """Raise ModelError: some faults of a graph show where it runs alone, as a window larger than what it pools."""
        try:
            return list(self._session.run(outputs, feed, self._options))
        except Exception as reason:  # of the runtime's errors, which have no common base
            raise ModelError(
                f"model {self.manifest.name!r} ({self.path}): ONNX Runtime {ort.__version__} cannot run it ({reason}); "
                "use the network that the manifest describes"
            ) from reason

    def _checked_input(self) -> str:
        spec = self.manifest.input
        nodes = {node.name: node for node in self._session.get_inputs()}
        if spec.intrinsics is not None:
            matrix = nodes.pop(self._named(spec.intrinsics, list(nodes), "input for the camera matrix"))
            if matrix.type != "tensor(float)" or not _fits(matrix.shape, (1, 3, 3)):
                found = f"{matrix.type} {matrix.shape}"
                raise self._wrong(f"input {spec.intrinsics!r}", "tensor(float) [1, 3, 3]", found)
        name = self._named(spec.name, list(nodes), "input")
        if len(nodes) > 1:
            raise self._wrong("inputs", "one image", f"{len(nodes)} ({', '.join(nodes)})")
        node = nodes[name]
        if node.type != _ELEMENT_TYPES[spec.dtype]:
            raise self._wrong(f"input {name!r}: type", _ELEMENT_TYPES[spec.dtype], node.type)
        coarse = self.manifest.coarse_look
        for image in (spec,) if coarse is None else (spec, coarse.image(spec)):
            if not _fits(node.shape, image.shape):
                expected = f"{list(image.shape)} ({image.layout}, {image.width} x {image.height})"
                raise self._wrong(f"input {name!r}: shape", expected, node.shape)
        return name

    def _checked_output(self) -> str:
        spec = self.manifest.output
        nodes = {node.name: node for node in self._session.get_outputs()}
        name = self._named(spec.name, list(nodes), "output")
        for wanted in self.manifest.maps:
            self._named(wanted, list(nodes), "map")
        node = nodes[name]
        if spec.kind == "ids":
            if not node.type.startswith(("tensor(int", "tensor(uint")):
                raise self._wrong(f"output {name!r}: type", "an integer tensor of class ids", node.type)
            if len(node.shape) not in (2, 3, 4):
                raise self._wrong(f"output {name!r}: shape", "[1, height, width]", node.shape)
            return name
        if node.type != "tensor(float)":
            raise self._wrong(f"output {name!r}: type", f"tensor(float) of {spec.kind}", node.type)
        if spec.is_depth:
            if not _one_channel(node.shape, spec.layout):
                raise self._wrong(f"output {name!r}: shape", "[1, h, w], or with one channel", node.shape)
            return name
        text = self.manifest.text
        count = len(self.manifest.classes) if text is None else text.dimensions
        allowed = (count, 1) if spec.kind == "probabilities" and count == 2 else (count,)
        axis = 1 if spec.layout == "NCHW" else 3
        channels = node.shape[axis] if len(node.shape) == 4 else None
        if len(node.shape) != 4 or (isinstance(channels, int) and channels not in allowed):
            what = "classes" if text is None else "dimensions of text.dimensions"
            shape = f"[1, {count}, h, w]" if spec.layout == "NCHW" else f"[1, h, w, {count}]"
            raise self._wrong(f"output {name!r}: shape", f"{shape} ({spec.layout}, {count} {what})", node.shape)
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
    124 MB with their weights instead of 253, and 184 instead of 367 where two threads run them, in the same time.
    """
    place = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    of_the_runtime = -1
    ort.create_and_register_allocator(place, ort.OrtArenaCfg(0, of_the_runtime, of_the_runtime, of_the_runtime))


def _session(content: bytes, path: Path, threads: int) -> ort.InferenceSession:
    """Call it with the lock."""
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
        return ort.InferenceSession(content, sess_options=options, providers=["CPUExecutionProvider"])
    # The runtime's errors have no common base but Exception; each of them means that this file cannot be run.
    except Exception as reason:
        raise ModelError(
            f"{path}: expected an ONNX network, found {len(content)} bytes that ONNX Runtime "
            f"{ort.__version__} rejects: {reason}"
        ) from reason


def _one_channel(shape: list[int | str | None], layout: str) -> bool:
    """Return whether a graph's shape holds one number a pixel: (h, w), (1, h, w) or four axes with one channel."""
    if len(shape) == 4:
        channels = shape[1 if layout == "NCHW" else 3]
        return not isinstance(channels, int) or channels == 1
    return len(shape) in (2, 3)


def _fits(found: list[int | str | None], expected: tuple[int, ...]) -> bool:
    """Return whether a graph's shape (names and None are free axes) takes a tensor of the expected shape."""
    return len(found) == len(expected) and all(
        not isinstance(size, int) or size == want for size, want in zip(found, expected, strict=True)
    )


def input_tensor(image: UInt8Array, spec: InputSpec) -> npt.NDArray[Any]:
    """Return the network's input tensor for a photo (H, W, 3) uint8 RGB, resized without keeping the aspect."""
    return as_tensor(fitted(image, spec), spec)


def fitted(image: UInt8Array, spec: InputSpec) -> UInt8Array:
    """Resize a photo (H, W, 3) uint8 RGB to the network's size. Shrinks by area (no aliasing), enlarges bilinearly."""
    height, width = image.shape[:2]
    if (width, height) == (spec.width, spec.height):
        return image
    shrinks = spec.width <= width and spec.height <= height
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (spec.width, spec.height), interpolation=method), np.uint8)


def as_tensor(image: UInt8Array, spec: InputSpec) -> npt.NDArray[Any]:
    """Return the tensor of a photo (height, width, 3) uint8 RGB of the network's size."""
    if spec.channels == "bgr":
        image = image[..., ::-1]
    planar = spec.layout == "NCHW"
    tensor: npt.NDArray[Any] = np.moveaxis(image, -1, 0) if planar else image
    if spec.dtype == "uint8":
        return np.ascontiguousarray(tensor[None])
    std = np.asarray(spec.std, dtype=np.float32)
    factor = np.float32(spec.scale) / std
    offset = np.asarray(spec.mean, dtype=np.float32) / std
    tensor = np.array(tensor, np.float32, order="C")
    by_channel = (3, 1, 1) if planar else (3,)
    tensor *= factor.reshape(by_channel)
    tensor -= offset.reshape(by_channel)
    return tensor[None]
