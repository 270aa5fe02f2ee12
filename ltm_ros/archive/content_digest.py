"""Compute digests of everything that a result depends on: files by content, configuration by value, the program by its
code.

Runs with equal results have equal digests; any change of a result changes its digest."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from pydantic import BaseModel

import ltm_core
import ltm_msgs_py
import ltm_ros.archive
import ltm_ros.recordings.importing
from ltm_core.base.resources import config_path
from ltm_core.depth.fusion_config import load_fusion_config
from ltm_core.fuel.overlays_io import Burn
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep, TracingConfig
from ltm_core.pipeline.fusing_step import FusingConfig, depth_manifest, label_columns
from ltm_core.site.networks import camera_label_errors, site_label_errors
from ltm_core.site.site import Site
from ltm_msgs_py.bag.cdr import CompressedPicture, RawPicture

_STUDY = ("evaluation", "training", "simulator", "bench")
_PACKAGES = ("numpy", "numba", "scipy", "onnxruntime", "opencv-python-headless", "rasterio", "pillow")
"""Other packages whose versions may change a bit of a result."""
_NOT_VOTES = {
    "cameras",
    "nodes",
    "terrain",
    "locating",
    "depth_model",
    "processes",
    "workers",
    "refine_poses",
    "limits",
}
_NOT_VOTES |= {"watchdog", "health", "region", "model", "label_heads", "labels", "name"}
"""Site keys without effect on the votes of a frame with known image, pose and calibration, or whose content is given
beside them."""
_SEEN = {"mask", "view_masks", "judge_pictures"}
"""Camera keys that decide which of its images show the landscape (`SceneFilter`)."""
_PLACES = {"crs", "origin", "dem", "coarser", "cameras", "assumed_pose_error"}
_NOT_VOTES_OF_FUEL = {"prior", "climate", "fusion", "label_errors"}
"""Site keys that turn votes into evidence."""


def digest(*parts: object) -> str:
    """Return the digest of values that JSON can write."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def burns_digest(burns: Sequence[Burn]) -> str:
    """Return the digest of burns with their times."""
    return digest(*([burn.stamp_ns, burn.cells.tolist()] for burn in burns))


def picture_digest(picture: CompressedPicture | RawPicture) -> str:
    """Return the digest of an image's content and encoding, not of its time: a fixed camera may send the same image
    again."""
    about = {name: value for name, value in vars(picture).items() if name not in ("data", "stamp_ns")}
    found = hashlib.blake2b(repr(sorted(about.items())).encode(), digest_size=16)
    found.update(picture.data)
    return found.hexdigest()


@cache
def code_digest() -> str:
    """Return the digest of the program: the sources of core and messages, those of this package, and their
    dependencies."""
    return _sources(ltm_core, ltm_msgs_py, ltm_ros.archive)


@cache
def importer_digest() -> str:
    """Return the digest of the program that places photos."""
    return _sources(ltm_core, ltm_msgs_py, ltm_ros.recordings.importing)


def _sources(*packages: ModuleType) -> str:
    found = hashlib.blake2b(digest_size=16)
    for package in packages:
        (place,) = package.__path__
        for file in sorted(Path(place).rglob("*.py")):
            if file.relative_to(place).parts[0] not in _STUDY:
                found.update(file.relative_to(place).as_posix().encode())
                found.update(file.read_bytes())
    versions = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return digest(found.hexdigest(), versions)


def votes_digest(site: Site, camera: str, tracing: TracingConfig, labelling: LabellingConfig) -> str:
    """Return the digest of everything that makes votes of a camera's frames, except the frames. Raises LtmError for
    missing files."""
    settings = site.model_dump(exclude=_NOT_VOTES)
    settings["fuel"] = site.fuel.model_dump(exclude=_NOT_VOTES_OF_FUEL)
    config = site.camera(camera)
    settings["camera"] = config.model_dump(include=_SEEN)
    step = LabellingStep(site, camera, labelling)
    settings["network"] = [step.described, step.manifest.model_dump(mode="json"), step.withdrawal.model_dump()]
    settings["labels"] = file_digest(config_path(site.labels))
    settings["steps"] = [tracing.model_dump()]
    return digest(_by_content(settings))


def measured_digest(site: Site, camera: str, votes: str, fusing: FusingConfig) -> str:
    """Return the digest of everything that measures a camera's frames, except the frames. `votes`: `votes_digest` of
    the camera, which includes terrain and labels. Raises LtmError for missing files."""
    network = depth_manifest(site, camera, fusing)
    constants = load_fusion_config(network).model_dump(mode="json")
    labels = label_columns(site, camera, fusing)
    return digest(votes, network.model_dump(mode="json"), constants, labels, fusing.angle_sigma_deg, fusing.dem_sigma)


def look_digest(site: Site, camera: str) -> str:
    """Return the digest of everything that decides whether a camera's image is clear, except the image."""
    config = site.camera(camera)
    return digest(_by_content(config.model_dump(include=_SEEN)), site.crs, list(site.origin))


def places_digest(site: Site) -> str:
    """Return the digest of what photos are placed by, except their own values. Raises LtmError for missing files."""
    return digest(_by_content(site.model_dump(include=_PLACES)))


def evidence_digest(site: Site) -> str:
    """Return the digest of everything that turns votes into evidence. Raises LtmError for missing files."""
    errors = site_label_errors(site), sorted(camera_label_errors(site).items())
    settings = site.fuel.model_dump(include=_NOT_VOTES_OF_FUEL - {"label_errors"})
    frame = [site.crs, list(site.origin)]
    return digest(_by_content(settings), frame, _by_content(errors))


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
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_by_content(item) for item in value]
    return value if isinstance(value, str | int | float | bool | None) else str(value)
