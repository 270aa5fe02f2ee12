"""Find, download and install networks (`ltm models add`): files, recipes, and the user's folder of models."""

import json
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import yaml
from pydantic import Field

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.storage.config_io import load_yaml, parse_yaml, read_text, read_yaml
from ltm_core.storage.disk_io import is_file, is_folder
from ltm_core.vision.manifest import (
    FUSION_SUFFIX,
    RECORDS,
    NetworkManifest,
    added_folder,
    find_file,
    shipped_names,
)
from ltm_core.vision.onnx_file import NetworkFile, file_digest, network_in, prompt_files

_LARGEST_SIDE_FILE: Final = 4 << 20
_GENERIC: Final = re.compile(r"^(model|onnx|end2end|network|[0-9a-f]{16,})([_-].*)?$|^(snapshots|resolve|main)$")
"""Names of files and folders that say nothing about the network."""

Progress = Callable[[int], None]


class Condition(StrictModel):
    """Properties that a file must all have: `model_type` of `config.json`, inputs, outputs, height and width."""

    model_types: tuple[str, ...] = ()
    inputs: frozenset[str] = frozenset()
    outputs: frozenset[str] = frozenset()
    sides: tuple[int, int] | None = None


class Recipe(StrictModel):
    """A public network: see `config/network_recipes.yaml`."""

    licence: str
    page: str
    url: str = Field("", pattern=r"^(https?://.*|)$")
    files: dict[str, str | None] = Field(default_factory=dict)
    when: tuple[Condition, ...] = ()
    manifest: dict[str, Any] = Field(default_factory=dict)


class RecipeFile(StrictModel):
    """Content of `config/network_recipes.yaml`."""

    normalisations: dict[str, dict[str, Any]]
    recipes: dict[str, Recipe]

    @classmethod
    @cache
    def load(cls) -> "RecipeFile":
        """Read the file that ships. Raises ConfigError."""
        return load_yaml(config_path("network_recipes.yaml"), cls)

    def named(self, name: str) -> Recipe:
        """Return a recipe by its name. Raises ModelError."""
        if name not in self.recipes:
            raise ModelError(f"no recipe {name!r}; recipes: {', '.join(self.recipes)}")
        return self.recipes[name]

    def matching(self, inputs: set[str], outputs: set[str], sides: tuple[Any, ...], model_type: str) -> str:
        """Return the name of the first recipe with a condition that a network meets, empty if none."""
        for name, recipe in self.recipes.items():
            for when in recipe.when:
                fits = when.inputs <= inputs and when.outputs <= outputs and when.sides in (None, sides)
                if fits and (not when.model_types or model_type in when.model_types):
                    return name
        return ""


@dataclass(frozen=True)
class Source:
    """A network to add. `stated`: keys of its manifest that are known. `config`, `preprocessor`: the JSON objects that
    hubs put beside it. `licence`: that of its README, empty if unknown. `recipe`: the name of its recipe, if known.
    `beside`: its fusion constants and reliability records, to copy."""

    file: Path
    name: str
    stated: dict[str, Any] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    preprocessor: dict[str, Any] = field(default_factory=dict)
    licence: str = ""
    recipe: str = ""
    beside: tuple[Path, ...] = ()

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return width and height of the image for a free size: the preprocessor's, else those given, if not 0."""
        size = self.preprocessor.get("size")
        size = {"height": size, "width": size} if isinstance(size, int) else size if isinstance(size, dict) else {}
        known = {key: value for key, value in size.items() if isinstance(value, int) and value > 0}
        if short := known.get("shortest_edge", 0):
            usual = min(round(short * 16 / 9), known.get("longest_edge", 2 * short)), short
        else:
            usual = width or 640, height or 352
        return (known["width"], known["height"]) if {"height", "width"} <= set(known) else usual

    def class_names(self) -> list[str]:
        """Return the names of the classes of its `config.json`, the repeated ones numbered; empty if it has none."""
        given = self.config.get("id2label")
        keys = sorted(given, key=lambda key: (len(str(key)), str(key))) if isinstance(given, dict) else []
        names = [str(self.config["id2label"][key]) for key in keys]
        return [name if name not in names[:at] else f"{name} {at}" for at, name in enumerate(names)]

    def normalisation(self, stated: str, usual: str) -> dict[str, Any] | None:
        """Return the keys of `InputSpec` for the values of pixels: those of the normalisation `stated`, of the
        preprocessor, or of the `usual` normalisation; None if nothing states them. Raises ModelError for another."""
        named, given = RecipeFile.load().normalisations, self.preprocessor
        if name := stated or ("" if given else usual):
            if name not in named:
                raise ModelError(f"normalise is {name!r}; choose one of {', '.join(named)}")
            return dict(named[name])
        if not given:
            return None
        found: dict[str, Any] = {"channels": "bgr"} if given.get("do_flip_channel_order") else {}
        if given.get("do_rescale", True):
            found["scale"] = float(given.get("rescale_factor") or 1.0 / 255.0)
        if given.get("do_normalize", "image_mean" in given):
            found |= {"mean": given.get("image_mean", [0.5] * 3), "std": given.get("image_std", [0.5] * 3)}
        return found


@contextmanager
def source_of(given: str, progress: Progress = lambda received: None) -> Iterator[Source]:
    """Yield the network that `ltm models add` is to add: an ONNX file, its folder, a manifest, or a recipe by its name.

    The files of a recipe are downloaded into the user's folder of models, and deleted once the network is added;
    `progress` gets the bytes received. Raises ModelError."""
    path = Path(given)
    if path.suffix in (".yaml", ".yml"):
        yield _of_manifest(path)
    elif is_folder(path):
        yield _of_file(network_in(path))
    elif is_file(path):
        yield _of_file(path)
    elif path.suffix or "/" in given:
        raise ModelError(f"{given}: no such file or folder; give an ONNX file, its folder, a manifest, or a recipe")
    else:
        recipe, folder = RecipeFile.load().named(given), added_folder() / ".downloads" / given
        if not recipe.url:
            how = f"export it from {recipe.page}, then: ltm models add FILE --like {given}"
            raise ModelError(f"{given}: no public ONNX export is known; {how}")
        for name, digest in recipe.files.items():
            download(f"{recipe.url}/{name}", folder / name, digest, progress)
        found = _of_file(next(folder / name for name in recipe.files if name.endswith(".onnx")))
        yield replace(found, name=given.replace("-", "_"), recipe=given)
        shutil.rmtree(folder)


def install(manifest: NetworkManifest, source: Source) -> NetworkManifest:
    """Copy a checked manifest and all its files to the user's models; return the new manifest. The files of each
    network have a folder of its own, so that no network overwrites another's. Raises ModelError for the name of a model
    that ships, or of another network that is installed."""
    folder, name = added_folder(), manifest.name
    target, files = folder / f"{name}.yaml", folder / name
    other = "add --name OTHER"
    if not re.fullmatch(r"\w[\w.-]*", name) or f"{name}.yaml".endswith(FUSION_SUFFIX):
        raise ModelError(f"a model cannot be named {name!r}; add --name with letters, digits, `_` and `-`")
    if name in shipped_names():
        raise ModelError(f"a model named {name!r} ships with LTM; {other}")
    if is_file(target) and NetworkManifest.load(target).sha256 != manifest.sha256:
        raise ModelError(f"{target}: another network of this name is installed; {other}, or delete that file")
    if is_folder(files) and not is_file(target):
        raise ModelError(f"{files}: exists, but has no manifest {target.name}; {other}, or delete it")
    folder.mkdir(parents=True, exist_ok=True)
    network = NetworkFile.read(manifest.model_file())
    content = manifest.model_dump(mode="json", exclude_defaults=True) | {"file": f"{name}/{name}.onnx"}
    with TemporaryDirectory(dir=folder, prefix=".adding-") as made:
        stage = Path(made) / name

        def add(path: Path, parts: Iterable[str], to: str = "") -> None:
            for part in (path.name, *parts):
                copied = stage / (to if to and part == path.name else part)
                copied.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path.parent / part, copied)

        add(manifest.model_file(), network.weights, f"{name}.onnx")  # the graph refers to its weights by these names
        for section in ("text", "prompts"):
            for key in {"file", "tokenizer", "encoder"} & set(content.get(section, {})):
                path = manifest.file_of(Path(content[section][key]))
                add(path, NetworkFile.read(path).weights if key == "encoder" else ())
                content[section][key] = f"{name}/{path.name}"
        if is_file(manifest.folder / manifest.card):
            shutil.copyfile(manifest.folder / manifest.card, stage / "card.md")
            content["card"] = f"{name}/card.md"
        if NetworkFile.read(stage / f"{name}.onnx").digest != manifest.sha256:
            raise ModelError(f"{manifest.model_file()}: changed while it was copied; add it again")
        shutil.rmtree(files, ignore_errors=True)
        stage.replace(files)
    for beside in source.beside:
        record = beside.parent.name == RECORDS
        copy = folder / RECORDS / beside.name if record else folder / f"{name}{beside.name.removeprefix(source.name)}"
        copy.parent.mkdir(exist_ok=True)
        shutil.copyfile(beside, copy)
    target.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return NetworkManifest.load(target)


def merged(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested mappings, those of `second` over those of `first`."""
    both = {k: merged(first[k], v) for k, v in second.items() if isinstance(v, dict) and isinstance(first.get(k), dict)}
    return {**first, **second, **both}


def stated_by(options: Sequence[str]) -> dict[str, Any]:
    """Return the keys of a manifest that `--set KEY=VALUE` options state, values as YAML. Raises ConfigError."""
    stated: dict[str, Any] = {}
    for option in options:
        key, equals, value = option.partition("=")
        if not equals or not key:
            raise ConfigError(f"--set {option}: expected KEY=VALUE, as in output.kind=metric")
        content = parse_yaml(value, f"--set {key}")
        for part in reversed(key.split(".")):
            content = {part: content}
        stated = merged(stated, content)
    return stated


def download(url: str, target: Path, digest: str | None, progress: Progress = lambda received: None) -> None:
    """Download a file, continuing an interrupted download; `progress` gets the bytes received. `digest`: its SHA-256;
    None: that of the server's `X-Linked-ETag`, if it has one. A file with another digest is deleted. Raises
    ModelError."""
    import httpx

    if is_file(target) and digest is not None and file_digest(target) == digest:
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f"{target.name}.part")
    start = part.stat().st_size if is_file(part) else 0
    try:
        with httpx.Client(timeout=60.0, headers={"user-agent": "ltm"}) as client:
            request = client.build_request("GET", url, headers={"range": f"bytes={start}-"} if start else {})
            for _ in range(10):  # the first answer has the checksum, the last one the file
                answer = client.send(request, stream=True)
                linked = re.fullmatch(r'"?([0-9a-f]{64})"?', answer.headers.get("x-linked-etag", ""))
                digest = digest or (linked and linked[1])
                if answer.next_request is None:
                    break
                answer.close()
                request = answer.next_request
            if answer.status_code != 416:  # the part is the whole file
                answer.raise_for_status()
                received = start if answer.status_code == 206 else 0
                with part.open("ab" if received else "wb") as out:
                    for chunk in answer.iter_bytes():
                        out.write(chunk)
                        received += len(chunk)
                        progress(received)
            answer.close()
    except (httpx.HTTPError, OSError) as reason:
        raise ModelError(f"{url}: cannot be downloaded ({reason}); run the command again to continue") from reason
    if digest is not None and (found := file_digest(part)) != digest:
        part.unlink()
        raise ModelError(f"{url}: has sha256 {found}, expected {digest}; it was deleted")
    part.replace(target)


def _of_file(path: Path) -> Source:
    hub = [path.parent, path.parent.parent] if path.parent.name == "onnx" else [path.parent]
    found: dict[str, Any] = {}
    for key in ("config", "preprocessor_config"):
        file = next((folder / f"{key}.json" for folder in hub if is_file(folder / f"{key}.json")), None)
        try:
            content = {} if file is None else json.loads(read_text(file, _LARGEST_SIDE_FILE, ModelError))
        except ValueError as reason:
            raise ModelError(f"{file}: is not JSON ({reason}); download it again or remove it") from reason
        found[key] = content if isinstance(content, dict) else {}
    licence = ""
    for readme in (folder / "README.md" for folder in hub if is_file(folder / "README.md")):
        header = read_text(readme, _LARGEST_SIDE_FILE, ModelError)[:4000]
        licence = next(iter(re.findall(r"^licen[cs]e(?:_name)?:\s*(\S+)\s*$", header, re.MULTILINE)), "")
    names = [path.stem, *(parent.name for parent in path.absolute().parents)]
    telling = next((each.lower() for each in names if each and not _GENERIC.match(each.lower())), "model")
    name = re.sub(r"[^a-z0-9]+", "_", telling).strip("_") or "model"
    stated = {"prompts": files} if (files := prompt_files(hub)) else {}
    return Source(path, name, stated, found["config"], found["preprocessor_config"], licence)


def _of_manifest(path: Path) -> Source:
    content = read_yaml(path)
    if not isinstance(content, dict) or not isinstance(content.get("file"), str):
        raise ModelError(f"{path}: expected a mapping with `file`, the name of the ONNX file")
    folder = path.resolve().parent
    stated = {key: value for key, value in content.items() if key != "file"}
    name = str(content.get("name", path.stem))
    for section in ("text", "prompts"):
        if isinstance(files := content.get(section), dict):
            named = {k: v for k, v in files.items() if k in ("file", "tokenizer", "encoder") and isinstance(v, str)}
            stated[section] = files | {k: str(find_file(Path(v), folder, str(path))) for k, v in named.items()}
    if isinstance(card := content.get("card"), str) and is_file(folder / card):
        stated["card"] = str(folder / card)
    found = _of_file(find_file(Path(content["file"]), folder, str(path), str(content.get("source", ""))))
    beside = (path.with_name(f"{path.stem}{FUSION_SUFFIX}"), *(folder / RECORDS).glob("*.yaml"))
    return replace(found, name=name, stated=stated, beside=tuple(filter(is_file, beside)))
