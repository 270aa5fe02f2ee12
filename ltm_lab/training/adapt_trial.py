"""Trial of self-supervision: `python -m ltm_lab.training.adapt_trial SET...` teaches the depth head and scores fusion.

The teacher knows its limits. It is traced depth only where the network's labels say grass or bare, away from
silhouettes; overlapping frames of a turning camera must agree by range; depth is smooth where the image is; and where
nothing teaches, the network keeps its depth. Scores are of fused depth on views that taught nothing.
"""

from __future__ import annotations

import argparse
import copy
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch.nn import functional

from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.geometry.camera import Camera
from ltm_core.raster.dem import Dem
from ltm_core.geometry.grid import GridGeometry
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import Label, LabelSet
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.network_image import as_tensor, fitted
from ltm_core.vision.segmenter import Segmenter
from ltm_core.depth.fusion_config import load_fusion_config
from ltm_lab.evaluation.depth.fused_depth import DepthEvaluation, Given
from ltm_lab.evaluation.gallery.posed import ENGABREEN_POSITION, ENGABREEN_STATED
from ltm_lab.evaluation.gallery.real_photos_io import ENGABREEN_PHOTOS, read_engabreen_points, read_glacier
from ltm_lab.evaluation.terrain.canyon_io import PHOTOS, read_canyon
from ltm_lab.frames.truth_frames_io import TruthFrame, is_curved, open_dem, read_truth_frames
from ltm_lab.training.export import load_exported
from ltm_core.pose_estimation.points.resection import resect
from ltm_core.storage.image_io import read_rgb

WAYS = {
    "traced everywhere": {"limits": False, "keep": 0.0, "own": False, "steps": 200},  # what `ltm-lab train adapt` did
    "limits": {"limits": True, "keep": 0.5, "own": False, "steps": 200},
    "limits, own pyramid": {"limits": True, "keep": 0.5, "own": True, "steps": 80},
}
BATCH, VARIANTS = 3, 4


@dataclass
class Set:
    dem: Dem
    curved: bool
    taught: list[TruthFrame]
    judged: list[TruthFrame]


def rendered(folder: Path) -> Set:
    """Of each camera's views, the first two thirds teach; the rest, in other directions, judge."""
    by: dict[str, list[TruthFrame]] = {}
    for frame in read_truth_frames(folder):
        by.setdefault(frame.camera_name, []).append(frame)
    return Set(
        open_dem(folder),
        is_curved(folder),
        [f for v in by.values() for f in v[: (2 * len(v) + 1) // 3]],
        [f for v in by.values() for f in v[(2 * len(v) + 1) // 3 :]],
    )


def _photo_frame(name: str, stamp: int, photo: Any, camera: Camera, pose: Any, truth: Dem) -> TruthFrame:
    depth = TerrainTracer(truth).trace(camera.scaled(2), pose).depth()
    none = np.zeros(depth.shape, np.bool_)
    return TruthFrame(name, stamp, camera, pose, photo, depth, depth, np.zeros(depth.shape, np.uint8), none)


def engabreen(data: Path) -> Set:
    """Truth is the lidar DEM of 3 m; the system gets its mean over 30 m. The first photo teaches, the second judges."""
    dem, _ = read_glacier(data)
    fit = resect(read_engabreen_points(data), ENGABREEN_STATED, ENGABREEN_POSITION, bend=TerrainTracer(dem).bend)
    camera = fit.camera.scaled(3)
    g = dem.geometry
    rows, cols = g.height // 10, g.width // 10
    cut = dem.elevation[: rows * 10, : cols * 10]
    with np.errstate(all="ignore"):
        coarse = np.nanmean(cut.reshape(rows, 10, cols, 10), axis=(1, 3)).astype(np.float32)
    given = Dem(coarse, GridGeometry(g.x_min, g.y_max, g.resolution * 10, cols, rows, g.crs))
    frames = [
        _photo_frame(
            name, k + 1, np.ascontiguousarray(read_rgb(data / "engabreen" / name)[::3, ::3]), camera, fit.pose, dem
        )
        for k, name in enumerate(ENGABREEN_PHOTOS)
    ]
    return Set(given, True, frames[:1], frames[1:])


def canyon(data: Path) -> Set:
    """Truth is the survey of each photo's day; the system gets that of 2011. The first photo teaches."""
    site = read_canyon(data / "grandcanyon_rm22")
    fit = site.resection
    frames = [
        _photo_frame(day, k + 1, site.photo(day, 3), fit.camera.scaled(3), fit.pose, site.surveys[day])
        for k, day in enumerate(PHOTOS)
    ]
    return Set(site.surveys["111006"], True, frames[:1], frames[1:])


class Example:
    """Encoder maps of one variant of a frame, with what teaches it."""

    def __init__(self, network: Any, photo: Any, target: Any, manifest: NetworkManifest) -> None:
        tensor = torch.from_numpy(as_tensor(fitted(photo, manifest.input).pixels, manifest.input).astype(np.float32))
        with torch.inference_mode():
            maps = network.encoder(tensor)[1:]
            self.before = network.inverse(network.depth(network.own.quarter(maps))).clone()
        self.maps = [m.clone() for m in maps]
        with torch.no_grad():
            self.quarter = network.own.quarter(self.maps)
        size = (manifest.input.width // 2, manifest.input.height // 2)
        self.target = torch.from_numpy(cv2.resize(target, size, interpolation=cv2.INTER_NEAREST))
        small = functional.interpolate(tensor, self.before.shape[2:], mode="area")
        self.edge_x = torch.exp(-4 * (small[..., 1:] - small[..., :-1]).abs().mean(1, keepdim=True))
        self.edge_y = torch.exp(-4 * (small[..., 1:, :] - small[..., :-1, :]).abs().mean(1, keepdim=True))


def teacher(frame: TruthFrame, tracer: TerrainTracer, segmenter: Segmenter, limits: bool) -> Any:
    """(H, W) log inverse depth that the terrain teaches, NaN elsewhere."""
    depth = tracer.trace(frame.camera, frame.pose).depth()
    known = np.isfinite(depth) & (depth > 0)
    target = np.where(known, -np.log(np.where(known, depth, 1.0)), np.nan).astype(np.float32)
    if limits:
        labels = segmenter.segment(frame.photo).labels
        open_ = np.isin(labels, (int(Label.GRASS), int(Label.BARE))).astype(np.uint8)
        open_ = cv2.erode(open_, np.ones((9, 9), np.uint8)) > 0
        filled = np.where(known, target, -12.0)
        step = cv2.dilate(filled, np.ones((3, 3))) - cv2.erode(filled, np.ones((3, 3))) > 0.15
        near = cv2.dilate(step.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        target[~open_ | near] = np.nan
    return target


def variants(photo: Any, target: Any, rng: np.random.Generator) -> Any:
    """The frame, and random crops, flips and tones of it."""
    yield photo, target
    height, width = target.shape
    for _ in range(VARIANTS - 1):
        share = rng.uniform(0.7, 1.0)
        h, w = round(height * share), round(width * share)
        r, c = rng.integers(0, height - h + 1), rng.integers(0, width - w + 1)
        part, goal = photo[r : r + h, c : c + w], target[r : r + h, c : c + w]
        if rng.uniform() < 0.5:
            part, goal = part[:, ::-1], goal[:, ::-1]
        tone = (part / 255.0) ** rng.uniform(0.7, 1.4) * rng.uniform(0.85, 1.15, 3) * 255
        yield np.ascontiguousarray(np.clip(tone, 0, 255).astype(np.uint8)), np.ascontiguousarray(goal)


def overlap(a: TruthFrame, b: TruthFrame, shape: Any) -> Any:
    """Sampling grid into `a` for the pixels of `b`, and what range is longer than depth by, of both, in logarithms."""
    h, w = shape
    ca, cb = a.camera.resized(w, h), b.camera.resized(w, h)
    rays = cb.rays().reshape(-1, 3)
    inside = rays @ (a.pose.rotation.T @ b.pose.rotation).T
    pixels = ca.project(inside)
    good = (inside[:, 2] > 0.1) & np.isfinite(pixels).all(1)
    grid = np.where(good[:, None], (pixels + 0.5) / np.array([w, h]) * 2 - 1, 9.0).reshape(1, h, w, 2)
    longer = np.log(np.linalg.norm(inside, axis=1) / np.maximum(inside[:, 2], 0.1)) - np.log(
        np.linalg.norm(rays, axis=1) / rays[:, 2]
    )
    return torch.from_numpy(grid.astype(np.float32)), torch.from_numpy(longer.reshape(1, 1, h, w).astype(np.float32))


def loss_of(found: Any, example: Example, keep: float) -> Any:
    large = functional.interpolate(found, example.target.shape, mode="bilinear", align_corners=False)[0, 0]
    residual = large - example.target
    known = torch.isfinite(residual)
    loss = found.sum() * 0.0
    if int(known.sum()) > 200:
        off = residual[known]
        loss = loss + (off - off.detach().median()).abs().mean()
    if keep:
        change = found - example.before
        loss = loss + keep * (change - change.detach().median()).abs().mean()
        x, y = (found[..., 1:] - found[..., :-1]).abs(), (found[..., 1:, :] - found[..., :-1, :]).abs()
        loss = loss + 0.05 * ((x * example.edge_x).mean() + (y * example.edge_y).mean())
    return loss


def adapted(network: Any, data: Set, segmenter: Segmenter, manifest: NetworkManifest, way: dict[str, Any]) -> Any:
    network = copy.deepcopy(network).eval()
    tracer = TerrainTracer(data.dem, data.curved)
    rng = np.random.default_rng(0)
    examples: list[Example] = []
    plain: list[Example] = []
    for frame in data.taught:
        target = teacher(frame, tracer, segmenter, way["limits"])
        for k, (photo, goal) in enumerate(variants(frame.photo, target, rng)):
            examples.append(Example(network, photo, goal, manifest))
            if k == 0:
                plain.append(examples[-1])
    taught = float(np.mean([torch.isfinite(e.target).float().mean().item() for e in plain]))
    pairs = []
    for i, (a, b) in enumerate(zip(data.taught, data.taught[1:])):
        if way["limits"] and a.camera_name == b.camera_name:
            pairs.append((plain[i], plain[i + 1], *overlap(a, b, plain[i].before.shape[2:])))
    parts = [network.depth, network.inverse, *([network.own] if way["own"] else [])]
    for p in network.parameters():
        p.requires_grad_(False)
    weights = [p.requires_grad_(True) for part in parts for p in part.parameters()]
    optimiser = torch.optim.AdamW(weights, lr=5e-4 if not way["own"] else 2e-4, weight_decay=0.01)

    def head(example: Example) -> Any:
        quarter = network.own.quarter(example.maps) if way["own"] else example.quarter
        return network.inverse(network.depth(quarter))

    rate = optimiser.param_groups[0]["lr"]
    for step in range(1, way["steps"] + 1):
        optimiser.param_groups[0]["lr"] = rate * 0.5 * (1 + np.cos(np.pi * step / way["steps"]))
        loss = sum(loss_of(head(examples[i]), examples[i], way["keep"]) for i in rng.integers(0, len(examples), BATCH))
        loss = loss / BATCH
        if pairs:
            a, b, grid, longer = pairs[rng.integers(len(pairs))]
            warped = functional.grid_sample(head(a), grid, align_corners=False)
            off = (warped - longer) - head(b)
            off = off[(grid.abs() < 1).all(-1)[:, None]]
            if off.numel() > 50:
                loss = loss + 0.3 * (off - off.detach().median()).abs().mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
    return network, taught


def scored(network: Any, data: Set, segmenter: Segmenter, manifest: NetworkManifest) -> dict[str, Any]:
    config = load_fusion_config(manifest)
    run = DepthEvaluation(0.0, data.dem, ClassPriors.of(LabelSet.load(), config), data.curved, None, config)
    for frame in data.judged:
        tensor = torch.from_numpy(
            as_tensor(fitted(frame.photo, manifest.input).pixels, manifest.input).astype(np.float32)
        )
        with torch.inference_mode():
            maps = network.encoder(tensor)[1:]
            values = torch.exp(network.inverse(network.depth(network.own.quarter(maps))))[0, 0].numpy()
        labels = segmenter.segment(frame.photo).labels
        run.add(frame, Given(NetworkDepth(values, "relative_inverse"), labels, segmenter.manifest.label_columns))
    score = run.score()
    rows = {
        source: [
            (s.pixels, round(s.rmse, 2), round(s.median, 2))
            for s in next(r.scores for r in score.rows if (r.source, r.group) == (source, "all"))
        ]
        for source in ("traced", "network", "fused")
    }
    return {"verdicts": dict(score.verdicts), **rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="+", help="engabreen, canyon, or a folder of `ltm-lab simulate`")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    manifest, segmenter = NetworkManifest.find("landscape_v2_depth"), Segmenter.open("landscape_v2", 2)
    network = load_exported(manifest)
    assert network.own is not None
    found: dict[str, Any] = {}
    for name in given.sets:
        data = (
            {"engabreen": engabreen, "canyon": canyon}[name](given.data)
            if name in ("engabreen", "canyon")
            else rendered(Path(name))
        )
        found[Path(name).name] = rows = {"shipped": scored(network, data, segmenter, manifest)}
        print(name, "shipped", json.dumps(rows["shipped"]), flush=True)
        for title, way in WAYS.items():
            torch.manual_seed(0)
            taught_network, share = adapted(network, data, segmenter, manifest, way)
            rows[title] = {"taught pixels": round(share, 3), **scored(taught_network, data, segmenter, manifest)}
            print(name, title, json.dumps(rows[title]), flush=True)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
