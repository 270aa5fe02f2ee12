"""Determine the manifest of an ONNX network from its graph, a run, and the files that hubs put beside it.

What a user states counts before what a recipe states (`config/network_recipes.yaml`), and this before what is
determined here. What nothing determines is listed in one error, with the options to state it."""

import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.storage.config_io import checked
from ltm_core.vision.install_io import RecipeFile, Source, merged
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import DEPTH_KINDS, NetworkManifest
from ltm_core.vision.network_image import (
    DTYPES,
    InputSpec,
    as_tensor,
    camera_feed,
    constant_tensor,
    covered,
    image_feed,
)
from ltm_core.vision.onnx_file import NetworkFile, file_digest
from ltm_core.vision.onnx_model import open_session
from ltm_core.vision.prompts import prompted
from ltm_core.vision.vocabulary import labels_of_classes

_CAMERA: Final = re.compile(r"^k$|^rays?$|intrinsic|camera|cam_|^focal|^fov|^f_?px", re.IGNORECASE)
_NOT_IMAGE: Final = re.compile(r"ray|mask|depth|dir|cam", re.IGNORECASE)
_IMAGE: Final = re.compile(r"pixel|image|img|rgb|photo|input|^x$", re.IGNORECASE)
_TEXT: Final = re.compile(r"input_ids|attention_mask|token|prompt|text", re.IGNORECASE)
_DEPTH: Final = re.compile(r"depth|disp|points?($|_)|pts", re.IGNORECASE)
_BESIDE_DEPTH: Final = re.compile(r"conf|normal|ssi|uncert|mask|scale", re.IGNORECASE)
_SIDE: Final = 224  # about the size of the images that are run to find out which multiples of pixels a network takes
_MULTIPLES: Final = (1, 2, 4, 8, 14, 16, 28, 32, 64)

Node = Any
Values = npt.NDArray[Any]


def recognise(source: Source, stated: Mapping[str, Any], recipe: str = "", name: str = "") -> NetworkManifest:
    """Return the manifest of a network, whose files are where `source` has them.

    `stated`: further keys of the manifest, and `normalise`, a normalisation of `config/network_recipes.yaml`. `recipe`:
    the name of a recipe whose properties the network has. `name`: that of the model. Raises ModelError for a file that
    is no network or has another checksum than stated, and for properties that nothing determines."""
    known = merged(source.stated, stated)
    if wrong := [key for key in ("input", "output", "mapping", "text") if not isinstance(known.get(key, {}), dict)]:
        raise ModelError(f"{source.file}: {wrong[0]} is {known[wrong[0]]!r}; expected a mapping of keys to values")
    file = NetworkFile.read(source.file)
    if "sha256" in known and known["sha256"] not in (file.digest, file_digest(source.file)):
        expected = f"expected {known['sha256']}; download it again, or correct the checksum"
        raise ModelError(f"{source.file}: has sha256 {file.digest}, {expected}")
    try:
        network = _Recognition(source, file, known, recipe or source.recipe)
        content = network.content()
    except ConfigError as reason:
        raise ModelError(str(reason)) from reason
    dimensions = content.pop("dimensions", 0)
    if content["output"]["kind"] == "embeddings":
        content["text"] = {"dimensions": dimensions, **content.get("text", {})}
    elif not any(_TEXT.search(constant) for constant in content["input"].get("constants", {})):
        content.pop("prompts", None)
    for files in (content.get("text", {}), content.get("prompts", {})):
        files |= {k: str(Path(str(v)).resolve()) for k, v in files.items() if k in ("file", "tokenizer", "encoder")}
    content |= {"name": name or known.get("name") or source.name, "file": str(source.file.absolute())}
    manifest = NetworkManifest.of(content | {"sha256": file.digest}, str(source.file))
    return prompted(manifest, {}, LabelSet.load()) if network.takes_prompts else manifest


class _Recognition:
    """One network. `missing`: what cannot be determined, each as a clause with the option to state it."""

    def __init__(self, source: Source, file: NetworkFile, stated: Mapping[str, Any], recipe: str) -> None:
        self.path, self.source, self.stated, self.config = source.file, source, stated, source.config
        self.session, self.quiet = open_session(file, source.file), ort.RunOptions()
        self.inputs: dict[str, Node] = {node.name: node for node in self.session.get_inputs()}
        self.outputs: dict[str, Node] = {node.name: node for node in self.session.get_outputs()}
        self.quiet.log_severity_level = 4  # failures at some sizes are expected
        self.missing: list[str] = []
        self.unknown_inputs = self.takes_prompts = False
        self.shape = self._image_shape(stated)
        self.sides = self.shape[1:3] if self._layout(stated) == "NHWC" else self.shape[2:]
        recipes, kind = RecipeFile.load(), str(self.config.get("model_type", ""))
        self.recipe = recipe or recipes.matching(set(self.inputs), set(self.outputs), tuple(self.sides), kind)
        known = merged({"input": {}, "output": {}}, recipes.named(self.recipe).manifest if self.recipe else {})
        if self.config.get("depth_estimation_type") == "metric":
            known["output"] = {**known["output"], "kind": "metric"}
        usual = known["input"].get("constants", {})
        known["input"] = {**known["input"], "constants": {n: v for n, v in usual.items() if n in self.inputs}}
        self.known = merged(known, stated)
        self.has_camera = any(_CAMERA.search(name) or n.shape[-2:] == [3, 3] for name, n in self.inputs.items())
        if unknown := set(self.known["input"].get("constants", {})) - set(self.inputs):
            raise ModelError(f"{self.path}: has no input {', '.join(unknown)}; inputs: {_listed(self.inputs)}")

    def content(self) -> dict[str, Any]:
        """Return the content of the manifest. Raises ModelError with everything that cannot be determined."""
        image = self._input()
        if self.unknown_inputs:
            self._reject_if_missing()
        spec = checked(InputSpec, image, f"{self.path}: input")
        free = not any(isinstance(side, int) for side in self.sides)
        if "fit" not in image and not self.known.get("maps"):
            multiple = (image.get("multiple") or self._multiple(spec)) if free else 0
            spec = spec.model_copy(update={"fit": "aspect", "multiple": multiple} if multiple else {"fit": "pad"})
        if spec.fit == "aspect":
            sides = {k: max(1, round(getattr(spec, k) / spec.multiple)) * spec.multiple for k in ("width", "height")}
            spec = spec.model_copy(update=sides)
        output = self._output(self._run(spec))
        self._reject_if_missing()
        rest = {key: value for key, value in self.known.items() if key not in ("input", "output", "normalise")}
        usual = {"licence": self.source.licence or "unknown", "card": f"determined from {self.path.name}"}
        if self.recipe:
            recipe = RecipeFile.load().named(self.recipe)
            usual |= {"licence": self.source.licence or recipe.licence, "source": recipe.page}
        return {**usual, **rest, "input": spec.model_dump(mode="json", exclude_defaults=True), "output": output}

    # ---- input

    def _image_shape(self, stated: Mapping[str, Any]) -> list[Any]:
        """Find the input of the image; return its axes without the number of images of one view."""
        fits = [node for node in self.inputs.values() if len(node.shape) in (4, 5) and not _NOT_IMAGE.search(node.name)]
        named = [node for node in fits if _IMAGE.search(node.name)] or fits
        name = (stated.get("input") or {}).get("name")
        image = self.inputs.get(name) if name else named[0] if named else None
        if image is None or len(image.shape) not in (4, 5):
            how = "give the vision part of the network, or --set input.name=NAME"
            raise ModelError(f"{self.path}: has no input for an image ({_listed(self.inputs)}); {how}")
        if isinstance(image.shape[0], int) and image.shape[0] != 1:
            raise ModelError(f"{self.path}: takes {image.shape[0]} images at once; export it for one image")
        self.image = image
        return [image.shape[0], *image.shape[-3:]]

    def _layout(self, known: Mapping[str, Any]) -> str:
        given = known.get("input", {}).get("layout")
        return str(given or ("NHWC" if self.shape[3] == 3 and self.shape[1] != 3 else "NCHW"))

    def _input(self) -> dict[str, Any]:
        known = dict(self.known["input"])
        height, width = self.sides
        wide, tall = self.source.size(known.get("width", 0), known.get("height", 0))
        stated = self.stated.get("input", {})
        known["width"] = width if isinstance(width, int) else stated.get("width", wide)
        known["height"] = height if isinstance(height, int) else stated.get("height", tall)
        known["layout"], known["name"] = self._layout(self.known), self.image.name
        known["dtype"] = dtype = np.dtype(DTYPES.get(self.image.type, np.object_)).name
        if dtype not in ("float32", "float16", "uint8"):
            raise ModelError(f"{self.path}: input {self.image.name} is {self.image.type}; use float32 or uint8")
        if dtype != "uint8" and not {"scale", "mean", "std"} & set(known):
            given, usual = (str(of.get("normalise", "")) for of in (self.stated, self.known))
            found = self.source.normalisation(given, usual)
            if found is None:
                options = "|".join(RecipeFile.load().normalisations)
                self.missing.append(f"the normalisation (no preprocessor_config.json): --set normalise={options}")
            known |= found or {}
        constants = dict(known.get("constants", {}))
        for name, node in self.inputs.items():
            if name in constants or name == self.image.name or name == known.get("intrinsics"):
                continue
            if _CAMERA.search(name) or node.shape[-2:] == [3, 3] or node.shape[1:] == self.image.shape[1:]:
                known["intrinsics"] = name
            elif name == "num_tokens":
                patches = known["width"] * known["height"] // 14**2  # MoGe-2 takes 1200 to 3600
                constants[name] = min(max(patches, 1200), 3600)
            elif name == "pixel_mask":
                constants[name] = 1
            elif name == "attention_mask" and "input_ids" in self.inputs:
                if ids := constants.get("input_ids"):  # up to the end of text, the largest id of CLIP's tokenizer
                    rows = np.atleast_2d(ids)
                    constants[name] = (np.arange(rows.shape[1]) <= rows.argmax(axis=1)[:, None]).astype(int).tolist()
            elif _TEXT.search(name) and "prompts" in self.known:
                constants[name], self.takes_prompts = [[0]], True
                self.known |= {"classes": list(LabelSet.load().names), "mapping": {"sky": "sky"}}
            else:
                how = "prompts.tokenizer=tokenizer.json" if _TEXT.search(name) else f"input.constants.{name}=..."
                self.missing.append(f"input {name} {node.type} {node.shape}: --set {how}")
                self.unknown_inputs = True
        if constants:
            known["constants"] = constants
        return known

    # ---- runs

    def _feed(self, spec: InputSpec) -> dict[str, Values]:
        rng, size = np.random.default_rng(7), (spec.height, spec.width)
        tensor = as_tensor(rng.integers(0, 256, (*size, 3), dtype=np.uint8), spec)
        constants = {n: constant_tensor(v, self.inputs[n], size) for n, v in spec.constants.items()}
        feed = image_feed(self.image, tensor, constants)
        if spec.intrinsics in self.inputs:
            matrix = np.array([[size[1], 0, size[1] / 2], [0, size[1], size[0] / 2], [0, 0, 1.0]])
            feed |= camera_feed(self.inputs[spec.intrinsics], matrix, tensor, spec)
        return feed

    def _run(self, spec: InputSpec) -> dict[str, Values]:
        try:
            found = self.session.run(list(self.outputs), self._feed(spec), self.quiet)
        except ModelError:
            raise
        except Exception as reason:  # the runtime's errors have no common base; constants may have any shape
            raise ModelError(
                f"{self.path}: does not run on an image of {spec.width} x {spec.height} pixels ({reason}); state the "
                "size that it takes: --set input.width=... --set input.height=..."
            ) from reason
        return dict(zip(self.outputs, map(np.asarray, found), strict=True))

    def _multiple(self, spec: InputSpec) -> int:
        """Return the smallest multiple of pixels of which both sides must be, so that the network runs and each of its
        outputs covers the whole image; 0 if it does not run at other sizes."""
        given = self.source.preprocessor.get("ensure_multiple_of") or self.source.preprocessor.get("size_divisor")
        for multiple in (given,) if isinstance(given, int) and given > 0 else _MULTIPLES:
            # Odd numbers of the multiple, so that no larger one divides both.
            tall = (max(1, _SIDE // multiple) | 1) * multiple
            trial = spec.model_copy(update={"height": tall, "width": tall + 2 * multiple, "fit": "stretch"})
            with suppress(ModelError):
                if covered(trial, self._run(trial).values()):
                    return multiple
        return 0

    # ---- output

    def _output(self, found: dict[str, Values]) -> dict[str, Any]:
        known = dict(self.known["output"])
        name = known.get("name") or self._main(found)
        if name not in found:
            raise ModelError(f"{self.path}: has no output {name!r}; outputs: {_listed(self.outputs)}")
        values = found[name]
        known |= {"name": name, "kind": known.get("kind") or self._kind(name, values, found, known)}
        if known["kind"] in DEPTH_KINDS:
            self._beside_depth(known, found)
        elif known["kind"] == "embeddings":
            length = values.shape[-1 if values.ndim == 3 or known.get("layout") == "NHWC" else 1]
            self.known["dimensions"] = length
            if "text" not in self.known and "encoder" not in self.known.get("prompts", {}):
                files = "text.file=words.npz, or prompts.tokenizer=tokenizer.json and prompts.encoder=text_model.onnx"
                self.missing.append(f"the embeddings of the words, {length} numbers each: --set {files}")
        elif known["kind"] in ("logits", "probabilities", "ids", "masks"):
            self._classes(known, values, found)
        return known

    def _main(self, found: Mapping[str, Values]) -> str:
        """Return the name of the main output: masks of queries, labels, or depth, else the only or first image."""
        masks = [n for n, value in found.items() if value.ndim == 4 and self._queries(value, found)]
        depth = [n for n in found if _DEPTH.search(n) and not _BESIDE_DEPTH.search(n)]
        logits = [n for n in found if "logits" in n.lower() and found[n].ndim >= 3]
        images = [n for n, value in found.items() if value.ndim >= 2 and min(value.shape[-2:]) > 4]
        return (masks or logits or depth or images or list(found))[0]

    def _queries(self, masks: Values, found: Mapping[str, Values]) -> str:
        """Return the name of the output with class logits of the masks' queries, if there is one."""
        fits = [n for n, v in found.items() if v.ndim == 3 and v.shape[1] == masks.shape[1] and "logit" in n.lower()]
        return fits[0] if fits else ""

    def _kind(self, name: str, values: Values, found: Mapping[str, Values], known: Mapping[str, Any]) -> str:
        low, stated = name.lower(), str(self.config.get("depth_estimation_type", ""))
        if values.ndim == 4 and self._queries(values, found):
            return "masks"
        if _DEPTH.search(name) and not _BESIDE_DEPTH.search(name):
            if stated == "metric" or "metric" in low or "metric_scale" in found or self.has_camera:
                return "metric"
            if stated == "relative" or "disp" in low or "inverse" in low:
                return "relative_inverse"
            what = f"whether {name} is metres, inverse depth or depth of unknown scale"
            return self._unknown_kind(what, *DEPTH_KINDS)
        if np.issubdtype(values.dtype, np.integer):
            return "ids"
        if "text" in self.known or "embed" in low or "hidden" in low or "feature" in low:
            return "embeddings"
        if values.ndim < 3 or (values.ndim == 4 and 1 in (values.shape[1], values.shape[3]) and "logits" not in low):
            what = f"what output {name} {list(values.shape)} is"
            return self._unknown_kind(what, "probabilities", "logits", *DEPTH_KINDS)
        axis = 1 if known.get("layout", "NCHW") == "NCHW" else 3
        sums = values.astype(np.float64).sum(axis=min(axis, values.ndim - 1))
        unit = values.min() >= -1e-3 and values.max() <= 1.0 + 1e-3
        return "probabilities" if unit and np.allclose(sums, 1.0, atol=1e-2) else "logits"

    def _unknown_kind(self, what: str, *kinds: str) -> str:
        self.missing.append(f"{what}: --set output.kind={'|'.join(kinds)}")
        return ""

    def _beside_depth(self, known: dict[str, Any], found: Mapping[str, Values]) -> None:
        values = found[known["name"]]
        planes = values.ndim > 2 and values.shape[-1] in (1, 3) and values.shape[-3:][0] not in (1, 3)
        known.setdefault("layout", "NHWC" if planes else "NCHW")
        own_focal = known["kind"] == "metric" and not known.get("canonical_focal_px") and not self.has_camera
        for name, value in found.items():
            if re.search(r"^(valid|mask|.*_mask)$", name, re.IGNORECASE):
                known.setdefault("valid", name)
            elif known["kind"] == "metric" and value.size == 1 and "scale" in name.lower() and 3 in values.shape:
                known.setdefault("metre_scale", name)
            elif own_focal and value.size == 1 and re.search(r"focal|fov", name, re.IGNORECASE):
                known.setdefault("focal", name)

    def _classes(self, known: dict[str, Any], values: Values, found: Mapping[str, Values]) -> None:
        if known["kind"] == "masks":
            known.setdefault("queries", self._queries(values, found))
        self.known["classes"] = names = list(self.known.get("classes", ())) or self.source.class_names()
        if known["kind"] not in ("ids", "masks"):
            nhwc = values.ndim == 4 and values.shape[3] == len(names) != values.shape[1]
            known.setdefault("layout", "NHWC" if nhwc else "NCHW")
        if not names:
            channels = "" if known["kind"] == "ids" else f" of output {known['name']} {list(values.shape)}"
            what = f"the names of the classes{channels} (no config.json): --set 'classes=[sky, grass, ...]'"
            self.missing.append(what)
            return
        if not self.known.setdefault("mapping", labels_of_classes(names)):
            self.missing.append(f"the labels of the classes ({', '.join(names[:12])}): --set mapping.{names[0]}=tree")

    def _reject_if_missing(self) -> None:
        if self.missing:
            how = "or --like RECIPE for a network of a known kind (`ltm models` lists recipes)"
            raise ModelError(f"{self.path}: cannot be determined: {'; '.join(self.missing)}; {how}")


def _listed(nodes: Mapping[str, Node]) -> str:
    return ", ".join(f"{node.name} {node.type.removeprefix('tensor')} {node.shape}" for node in nodes.values())
