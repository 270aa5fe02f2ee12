"""Plan an archive's tasks, a camera's day each, and the names of results, digests of all that goes into them.

Runs with equal results have equal digests; any change of a result changes its digest."""

import hashlib
import importlib.metadata
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

import ltm_core
import ltm_msgs_py
import ltm_ros.archive
from ltm_core.base.resources import config_path
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep, TracingConfig
from ltm_core.site.networks import camera_label_errors, site_label_errors
from ltm_core.site.site import Site
from ltm_core.storage.config_io import checked
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.scan import digest
from ltm_ros.launching.graph import describe
from ltm_ros.runtime.frame_join import FrameJoinConfig

EVIDENCE = "evidence"
"""Folder of the tasks' results."""
_PACKAGES = ("numpy", "numba", "scipy", "onnxruntime", "opencv-python-headless", "rasterio", "pillow")
"""Other packages whose versions may change a bit of a result."""
_WITHOUT_EFFECT = {"cameras", "nodes", "processes", "workers", "watchdog", "health", "alerts", "region", "terrain"}
"""Site keys without effect on the evidence of frames with known image, pose and calibration, or given beside them."""
_SEEN = {"mask", "view_masks", "judge_pictures"}
"""Camera keys that decide which of its images show the landscape (`SceneFilter`)."""


@dataclass(frozen=True)
class TaskSettings:
    """What all tasks of a run share. `site`: path of the site file; `results`: a folder."""

    site: str
    results: Path
    code: str
    tracing: TracingConfig
    labelling: LabellingConfig


@dataclass(frozen=True)
class Task:
    """Some frames of one camera and day, in the order of their stamps. `site_key`: digest of what makes evidence of the
    camera's frames (`site_digest`); `key`: of all that goes into the result."""

    frames: tuple[ArchiveFrame, ...]
    site_key: str
    key: str

    @property
    def file(self) -> str:
        """Return the path of the result, below the folder of results."""
        return f"{EVIDENCE}/{self.key}.parquet"

    @property
    def label(self) -> str:
        """Return camera and day, for messages."""
        first = self.frames[0]
        return f"{first.camera} {np.datetime64(first.day, 'D')}"


def plan(frames: Sequence[ArchiveFrame], site: Site, settings: TaskSettings, frames_per_task: int) -> list[Task]:
    """Return tasks in the order of days, then cameras. Chunks of a day depend only on the order of its frames."""
    steps = settings.tracing, settings.labelling
    of_site = {name: site_digest(site, name, *steps) for name in {frame.camera for frame in frames}}
    days = defaultdict[tuple[int, str], list[ArchiveFrame]](list)
    for frame in frames:
        days[frame.day, frame.camera].append(frame)
    tasks = []
    for (_, camera), found in sorted(days.items()):
        for begin in range(0, len(found), frames_per_task):
            chunk = tuple(found[begin : begin + frames_per_task])
            identities = [frame.identity() for frame in chunk]
            key = digest(settings.code, of_site[camera], camera, identities)
            tasks.append(Task(chunk, of_site[camera], key))
    return tasks


def node_rules(
    site: Site, path: Path, camera: str
) -> tuple[FrameJoinConfig, tuple[float, float], TracingConfig, LabellingConfig]:
    """Return the parameters of a site's nodes for joining, stamps (`max_ahead`, `max_behind`), tracing and labelling.
    Raises ConfigError."""
    from ltm_ros.fuel_map.services import FuelMapConfig

    graph = describe(site, path)

    def only(model: type[Any], label: str) -> Any:
        values = {name: v for name, v in graph.node(label).parameters.items() if name in model.model_fields}
        return checked(model, values, f"parameters of {label}")

    fuel_map = only(FuelMapConfig, "fuel_map")
    join, tracing = only(FrameJoinConfig, f"{camera}/capture"), only(TracingConfig, f"{camera}/depth")
    limits = fuel_map.max_ahead, fuel_map.max_behind
    return join, limits, tracing, only(LabellingConfig, f"{camera}/segmentation")


@cache
def code_digest() -> str:
    """Return the digest of the program: the sources of core, messages and this package, and their dependencies."""
    found = hashlib.blake2b(digest_size=16)
    for package in (ltm_core, ltm_msgs_py, ltm_ros.archive):
        (place,) = package.__path__
        for file in sorted(Path(place).rglob("*.py")):
            found.update(file.relative_to(place).as_posix().encode())
            found.update(file.read_bytes())
    return digest(found.hexdigest(), {name: importlib.metadata.version(name) for name in _PACKAGES})


def site_digest(site: Site, camera: str, tracing: TracingConfig, labelling: LabellingConfig) -> str:
    """Return the digest of all that makes evidence of a camera's frames, except these. Raises LtmError."""
    own = LabellingStep(site, camera, labelling).segmenter
    network = [own.described, own.manifest.model_dump(mode="json"), own.withdrawal.model_dump()]
    errors = site_label_errors(site), sorted(camera_label_errors(site).items())
    labels = config_path(site.labels)
    settings = _by_content([site.model_dump(exclude=_WITHOUT_EFFECT), network, errors, labels])
    return digest(settings, seen_by_content(site, camera), tracing.model_dump())


def seen_by_content(site: Site, camera: str) -> list[Any]:
    """Return everything that decides whether a camera's image is clear, except the image, with files by content."""
    return [_by_content(site.camera(camera).model_dump(include=_SEEN)), site.crs, list(site.origin)]


def file_digest(path: Path) -> str:
    """Return the digest of a file's content, or of all files in a folder."""
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.is_file())
        return digest([[file.relative_to(path).as_posix(), file_digest(file)] for file in files])
    found = path.stat()
    return _content(path.resolve(), found.st_size, found.st_mtime_ns)


@cache
def _content(path: Path, size: int, changed_ns: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def _by_content(value: Any) -> Any:
    """Return the configuration with each path and array replaced by its content."""
    if isinstance(value, Path):
        return file_digest(value)
    if isinstance(value, np.ndarray):
        numbers = hashlib.blake2b(value.tobytes(), digest_size=16).hexdigest()
        return [str(value.dtype), list(value.shape), numbers]
    if isinstance(value, BaseModel):
        return _by_content(value.model_dump())
    if is_dataclass(value):
        return {one.name: _by_content(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _by_content(item) for key, item in value.items()}
    if isinstance(value, set | frozenset):
        return sorted(str(_by_content(item)) for item in value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_by_content(item) for item in value]
    return value if isinstance(value, str | int | float | bool | None) else str(value)
