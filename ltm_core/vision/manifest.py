"""Read model manifests: the file of a network, its input and output tensors, and the labels of its classes."""

import os
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import Field, PrivateAttr, model_validator

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.storage.config_io import checked, load_yaml
from ltm_core.storage.disk_io import is_file
from ltm_core.vision.network_image import InputSpec

DEFAULT_MODEL: Final = "landscape_v5"  # default segmentation network
DEFAULT_DEPTH_MODEL: Final = "landscape_v5_depth"  # default depth network: the second output of the same file
MODEL_PATH_VARIABLE: Final = "LTM_MODEL_PATH"

DepthKind = Literal["relative_inverse", "affine_invariant", "metric"]
"""Kinds of output with one depth per pixel; the others label pixels."""
DEPTH_KINDS: Final[tuple[str, ...]] = get_args(DepthKind)

RECORDS: Final = "reliability"  # folder beside manifests with the reliability records of their labels
FUSION_SUFFIX: Final = "_fusion.yaml"  # suffix of the file beside a manifest with the network's error model

SHIPPED_LABEL_HEAD: Final = "landscape"  # name of the label head that leaves the network's scores unchanged


class Withdrawal(StrictModel):
    """Thresholds below which labels are withdrawn and do not vote. `confidence`: of the probability. `tree_contrast`:
    of the photo's local contrast (`label_rules.contrast`) for *tree*, as on hazy far slopes, if the image shows more
    shrub than tree. 0: none."""

    confidence: float = Field(default=0.0, ge=0, lt=1)
    tree_contrast: float = Field(default=0.0, ge=0)


class OutputSpec(StrictModel):
    """The tensor that the network gives, at any resolution.

    Kinds of labels: `logits` and `probabilities` have a class axis (`layout` says where); `ids` is an integer class per
    pixel. One channel of `probabilities` with two classes is the probability of the second. `masks` (Mask2Former, EoMT,
    OneFormer) is the logit of each query's mask; the output `queries` has the class logits of each query, the last for
    no class. `embeddings` is a vector per pixel, or per patch as a list of tokens, which is compared with the
    embeddings of words in the manifest's `text` (LSeg, CLIP with dense features).

    Kinds of depth: `relative_inverse` is inverse depth up to a scale and a shift (MiDaS, Depth Anything: larger is
    nearer); `affine_invariant` is depth up to a scale and a shift (Marigold); `metric` is metres along the optical
    axis, or 1/m if `inverse`. Of three channels, which are 3-D points, the third is the depth.

    Outputs beside it: `valid`, the probability or logit that a pixel has a depth; `focal`, the focal length in pixels
    of the input, or the horizontal field of view (a name with `fov`), that the network assumed; `metre_scale`, the
    factor from affine-invariant 3-D points to metres, whose shift is solved from the camera's rays (MoGe-2). A metric
    network made for one focal length states it in pixels of its input (`canonical_focal_px`). Metres are multiplied by
    the true focal length over the assumed one (Metric3D: 1000; Depth Pro, `inverse`: the input's width)."""

    kind: Literal["logits", "probabilities", "ids", "masks", "embeddings", DepthKind]
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    name: str | None = None  # of the graph's output; the first if absent
    temperature: float = Field(default=1.0, gt=0)  # logits are divided by it: fitted so that probabilities hold
    # Class -> what is added to its logits: gives a class that training weighed up its true rarity (Menon et al. 2021).
    offsets: dict[str, float] = Field(default_factory=dict)
    # Class -> what is taken off its logits, at most, where the photo is redder than what is green (`label_rules`).
    redness: dict[str, Annotated[float, Field(gt=0, le=20)]] = Field(default_factory=dict)
    withdraw: Withdrawal = Withdrawal()
    queries: str | None = None
    valid: str | None = None
    focal: str | None = None
    metre_scale: str | None = None
    inverse: bool = False
    canonical_focal_px: float | None = Field(default=None, gt=0)

    @property
    def beside(self) -> tuple[str, ...]:
        """Return the names of the outputs that are read beside the main one."""
        return tuple(name for name in (self.queries, self.valid, self.focal, self.metre_scale) if name is not None)

    @property
    def is_depth(self) -> bool:
        """Return whether the output is a depth and not labels."""
        return self.kind in DEPTH_KINDS

    @model_validator(mode="after")
    def _keys_belong_to_the_kind(self) -> "OutputSpec":
        known = {"offsets": "logits", "redness": "logits", "queries": "masks"}
        known |= dict.fromkeys(("inverse", "canonical_focal_px", "focal", "metre_scale"), "metric")
        for key, kind in known.items():
            if getattr(self, key) and self.kind != kind:
                raise ValueError(f"{key} belongs to kind {kind}; remove it for {self.kind}")
        if self.kind == "masks" and self.queries is None:
            raise ValueError("kind masks needs queries, the output with the class logits of each query")
        if self.focal is not None and self.canonical_focal_px is not None:
            raise ValueError("focal and canonical_focal_px contradict each other; remove one")
        return self


class TextSpec(StrictModel):
    """Words of a network of kind `embeddings`. `file`: NumPy `.npz` with `names` (K,) strings and `embeddings` (K,
    dimensions) float; None: all come from the text encoder in `prompts`. The score of a word at a pixel is `scale`
    times the cosine between the two vectors (LSeg 14.3, CLIP 100)."""

    file: Path | None = None
    dimensions: int = Field(gt=0)
    scale: float = Field(default=100.0, gt=0)


class PromptSpec(StrictModel):
    """Files that turn prompts into the network's words or input. `tokenizer`: `tokenizer.json` of the text encoder.
    `encoder`: ONNX file from token ids to one vector per text; None: the network takes token ids itself (CLIPSeg)."""

    tokenizer: Path
    encoder: Path | None = None


class NetworkManifest(StrictModel):
    """Network file with the data needed to run and check it; YAML on disk.

    `mapping` gives each of the network's classes one of our label names (or `unlabelled`); a class it leaves out is
    unlabelled. A depth network has neither classes nor mapping. One file may serve two manifests, one of labels and one
    of depth, that name different outputs. For a network of kind `embeddings` the words of `text` are the classes."""

    name: str
    file: Path
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    input: InputSpec
    output: OutputSpec
    classes: tuple[str, ...] = ()
    mapping: dict[str, str] = Field(default_factory=dict)
    licence: str
    card: str  # a Markdown file beside the manifest, or a few words
    source: str = ""  # where the file can be had, for the message when it is absent
    text: TextSpec | None = None
    prompts: PromptSpec | None = None
    # Outputs of the graph that heads read -> channels; (1, C, h, w) float32 each (`label_head`).
    maps: dict[str, int] = Field(default_factory=dict)
    # The network, by name or path, that answers in this one's place where a camera has a head.
    heads_of: str = ""
    _folder: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _parts_fit_together(self) -> "NetworkManifest":
        out, text = self.output, self.text
        labels = text is None and not out.is_depth
        repeated = sorted({name for name in self.classes if self.classes.count(name) > 1})
        rules: list[tuple[object, str]] = [
            ((text is None) == (out.kind == "embeddings"), "text belongs to output kind embeddings, which needs it"),
            (
                text and not text.file and not (self.prompts and self.prompts.encoder),
                "text needs file, or prompts with the text encoder",
            ),
            (self.maps and out.kind != "logits", f"maps belong to output kind logits; remove them for {out.kind}"),
            (min(self.maps.values(), default=1) < 1, "maps: each has at least one channel"),
            (text and self.classes, "classes: the words of the text file are the classes; remove the key"),
            (
                out.is_depth and (self.classes or self.mapping),
                f"classes and mapping belong to labels; remove them for output kind {out.kind}",
            ),
            (labels and not self.classes, f"classes: missing; output kind {out.kind} needs it"),
            (labels and not self.mapping, f"mapping: missing; output kind {out.kind} needs it"),
            (repeated, f"classes has {', '.join(repeated)} more than once"),
        ]
        named = {"output.offsets": {*out.offsets}, "output.redness": {*out.redness}, "mapping": {*self.mapping}}
        for key, names in named.items():
            strangers = [] if text and key == "mapping" else sorted(names - set(self.classes))
            message = f"{key} names {', '.join(strangers)}, not among classes ({', '.join(self.classes)})"
            rules.append((strangers, message))
        for broken, message in rules:
            if broken:
                raise ValueError(message)
        return self

    @classmethod
    def load(cls, path: Path) -> "NetworkManifest":
        """Read a manifest. Raises ModelError naming the file and each key at fault."""
        try:
            manifest = load_yaml(path, cls)
        except ConfigError as reason:
            raise ModelError(str(reason)) from reason
        manifest._folder = path.resolve().parent
        return manifest

    @classmethod
    def of(cls, content: dict[str, Any], place: str) -> "NetworkManifest":
        """Return a manifest that has no file yet; its files have absolute paths. `place` is named in the ModelError."""
        try:
            return checked(cls, content, place)
        except ConfigError as reason:
            raise ModelError(str(reason)) from reason

    @classmethod
    def find(cls, path_or_name: "str | Path | NetworkManifest") -> "NetworkManifest":
        """Read a manifest by path (`*.yaml`) or by its name in `config/models` or among those added."""
        if isinstance(path_or_name, NetworkManifest):
            return path_or_name
        text = str(path_or_name)
        if text.endswith((".yaml", ".yml")) or os.sep in text:
            return cls.load(Path(path_or_name))
        for path in (folder / f"{text}.yaml" for folder in (models_folder(), added_folder())):
            if is_file(path):
                return cls.load(path)
        names = ", ".join(installed_names())
        raise ModelError(f"no model {text!r}; installed models: {names} (or give the path of a manifest)")

    def require(self, depth: bool) -> "NetworkManifest":
        """Return the manifest if it is of a depth network (`depth`) or of a label network. Raises ModelError."""
        if self.output.is_depth == depth:
            return self
        found, key = ("depth, not labels", "depth_model") if self.output.is_depth else ("labels, not depth", "model")
        raise ModelError(
            f"model {self.name!r} predicts {found} (output.kind {self.output.kind}); name it as `{key}`, and choose a "
            f"{'depth' if depth else 'label'} network here"
        )

    def serving(self, head: str) -> "NetworkManifest":
        """Return the network used by a camera with this label head: itself, or the network of its heads (`heads_of`):
        one network may label best, and the maps of another train the best heads. Raises ModelError if it is missing."""
        return NetworkManifest.find(self.heads_of) if self.heads_of and head != SHIPPED_LABEL_HEAD else self

    @property
    def folder(self) -> Path:
        """Return the folder of the manifest file: where its relative paths start."""
        return self._folder

    def model_file(self) -> Path:
        """Return the path of the network, as `find_file` finds it. Raises ModelError."""
        return self.file_of(self.file)

    def file_of(self, file: Path) -> Path:
        """Return the path of a file that the manifest names, found as the network is. Raises ModelError."""
        return find_file(file, self.folder, f"model {self.name!r}", self.source)


def find_file(file: Path, folder: Path, what: str, source: str = "") -> Path:
    """Return the path of a file beside a manifest in `folder`, else in a folder of `LTM_MODEL_PATH`, by path or bare
    name. `what` names the model and `source` the file's origin in the ModelError for a missing file."""
    listed = [] if file.is_absolute() else os.environ.get(MODEL_PATH_VARIABLE, "").split(os.pathsep)
    places = [folder / file, *(Path(other) / name for other in filter(None, listed) for name in (file, file.name))]
    if found := next(filter(is_file, places), None):
        return found
    searched = ", ".join(dict.fromkeys(map(str, places)))
    origin = f" (source: {source})" if source else ""
    raise ModelError(
        f"{what}: no file {file}; searched {searched}. Put it in one of these places or name its folder in "
        f"{MODEL_PATH_VARIABLE}{origin}"
    )


def models_folder() -> Path:
    """Return the folder of the manifests that ship with the system."""
    return config_path("labels.yaml").parent / "models"


def added_folder() -> Path:
    """Return the folder of the models that a user added (`ltm models add`): `ltm/models` in the user's data folder."""
    data = os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(data) / "ltm" / "models"


def shipped_names() -> list[str]:
    """Return the names of the manifests in `config/models`, sorted."""
    return _names(models_folder())


def installed_names() -> list[str]:
    """Return the names of the manifests that ship, then of those that a user added, each sorted."""
    return [*shipped_names(), *_names(added_folder())]


def _names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.yaml") if not path.name.endswith(FUSION_SUFFIX))
