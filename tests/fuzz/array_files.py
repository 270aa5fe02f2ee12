"""Readers of networks, arrays and depth maps."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import yaml
from scenes.networks import HEIGHT, WIDTH, write_classifier

from fuzz.target import Target
from ltm_core.base.errors import ConfigError
from ltm_core.geometry.camera import Camera
from ltm_core.storage.text_io import load_arrays
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.depth.depth_maps_io import DepthMapFolder


def _network(folder: Path) -> list[bytes]:
    write_classifier(folder)
    return [(folder / "colors.onnx").read_bytes()]


def _read_network(folder: Path) -> None:
    """The manifest states the spoiled file's checksum, as one that was made to harm would."""
    manifest = yaml.safe_load((folder / "colors.yaml").read_text())
    manifest["sha256"] = hashlib.sha256((folder / "colors.onnx").read_bytes()).hexdigest()
    (folder / "colors.yaml").write_text(yaml.safe_dump(manifest))
    Segmenter.open(folder / "colors.yaml").segment(np.zeros((HEIGHT, WIDTH, 3), np.uint8))


def _npz(folder: Path) -> list[bytes]:
    files = []
    for save in (np.savez, np.savez_compressed):
        file = io.BytesIO()
        save(file, names=np.array(["a", "bc"]), embeddings=np.asfortranarray(np.ones((2, 3), np.float32)))
        files.append(file.getvalue())
    return files


def _depth_maps(suffix: str) -> Callable[[Path], list[bytes]]:
    def made(folder: Path) -> list[bytes]:
        (folder / "maps").mkdir()
        (folder / "maps/depth_maps.yaml").write_text("metres_per_unit: 0.001\n")
        depth = np.random.default_rng(6).integers(1, 60_000, (9, 14)).astype(np.uint16)
        file = io.BytesIO()
        np.save(file, depth.astype(np.float32))
        return [file.getvalue()] if suffix == "npy" else [cv2.imencode(f".{suffix}", depth)[1].tobytes()]

    return made


def _read_depth_map(folder: Path) -> None:
    DepthMapFolder.open("maps", folder / "maps").of_frame("a", 5, (90, 140), Camera.from_fov(14, 9, 50.0))


def _read_npz(folder: Path) -> None:
    load_arrays(folder / "a.npz", ("names", "embeddings"), 1 << 20, ConfigError)


ARRAY_FILES = (
    Target("network", "colors.onnx", _network, _read_network),
    Target("npz", "a.npz", _npz, _read_npz),
    *(
        Target(f"depth_map_{suffix}", f"maps/a_5.{suffix}", _depth_maps(suffix), _read_depth_map)
        for suffix in ("npy", "png", "tif")
    ),
)
