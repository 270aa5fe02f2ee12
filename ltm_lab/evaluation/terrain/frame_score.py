"""Score the surface map on simulated frames: it starts from the surface of one date and gets frames of another.

Its depth is the frames' true depth with noise, or the depth that a network measures in their photos."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.base.types import BoolArray, Float32Array
from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.depth.topodepth import fuse
from ltm_core.raster.dem import Dem
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.layers import SurfaceLayers
from ltm_core.surface.observation import DepthFrame
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.metrics.change import ChangeScore, score_change
from ltm_lab.evaluation.metrics.heights import SurfaceScore, cell_means, score_surface
from ltm_lab.evaluation.terrain.hillside_scenes import Noise
from ltm_lab.frames.truth_frames_io import TruthFrame

HOUR_NS = 3_600_000_000_000
_SURE = np.diag([1e-6] * 3 + [1e-12] * 3)
Measure = Callable[[TruthFrame], tuple[DepthFrame, str]]
"""Returns the depth that a camera measures in a frame, and the verdict of the fusion."""


@dataclass(frozen=True, eq=False)
class FrameScore:
    """The score of a map after `frames` frames.

    `change` counts the cells that independent views have seen; a cell has changed if it moved by the map's threshold
    (`truth`). `before` and `after` are the heights of the changed cells as given and as updated. `tails` are the shares
    of the other cells whose estimate is off by more than 3 and 5 of its sigmas. `verdicts` are those of the fusion."""

    frames: int
    change: ChangeScore
    before: SurfaceScore
    after: SurfaceScore
    tails: tuple[float, float]
    verdicts: Counter[str]
    layers: SurfaceLayers
    truth: BoolArray


def score_frames(
    frames: Iterable[TruthFrame],
    ground: Dem,
    before: Dem,
    now: Dem,
    measure: Measure,
    config: TerrainConfig,
    looks: int = 1,
    gone: Float32Array | None = None,
    earlier: Iterable[TruthFrame] = (),
) -> FrameScore:
    """Add frames to a map, an hour apart whatever their stamps are, and compare it with the true surface `now`.

    Args:
        ground, before: bare earth and surface from which the map starts, in the map frame.
        looks: how often each frame is added; the errors of photos repeat.
        gone: weights of labels, see `SurfaceMap`.
        earlier: frames of the date of `before`, which are added first.

    Raises RasterError, PoseError and ImageError.
    """
    reference = Reference.of(ground, before, config.resolution)
    truth = cell_means(now.elevation, now.geometry, reference.geometry)
    kept = [*earlier, *list(frames) * looks]
    surface = SurfaceMap(reference, config, sorted({frame.camera_name for frame in kept}), gone=gone)
    verdicts: Counter[str] = Counter()
    for number, frame in enumerate(kept):
        seen, verdict = measure(frame)
        verdicts[verdict] += 1
        surface.add(replace(seen, stamp_ns=frame.stamp_ns + number * HOUR_NS))
    surface.decide()
    layers = surface.layers()
    known = layers.observed & np.isfinite(truth) & np.isfinite(reference.surface)
    moved = np.nan_to_num(np.abs(truth - reference.surface)) >= config.threshold
    return FrameScore(
        len(kept),
        score_change(layers.change > 0, moved, known),
        score_surface(reference.surface, truth, known & moved),
        score_surface(layers.height, truth, known & moved),
        _tails((layers.estimate - truth)[known & ~moved] / layers.sigma[known & ~moved]),
        verdicts,
        layers,
        moved,
    )


def _tails(errors: Float32Array) -> tuple[float, float]:
    if not len(errors):
        return float("nan"), float("nan")
    return float((np.abs(errors) > 3).mean()), float((np.abs(errors) > 5).mean())


def true_depth(noise: Noise, seed: int = 1) -> Measure:
    """Return true depth with sigma `constant` + `share` x range, independent by pixel, and the exact pose."""
    rng = np.random.default_rng(seed)

    def measure(frame: TruthFrame) -> tuple[DepthFrame, str]:
        depth = frame.surface
        with np.errstate(invalid="ignore"):
            sigma = (noise.constant + noise.share * np.where(np.isfinite(depth), depth, 0)).astype(np.float32)
        measured = (depth + sigma * rng.standard_normal(depth.shape, np.float32)).astype(np.float32)
        everywhere = np.ones(depth.shape, np.bool_)
        camera, name = frame.camera.scaled(frame.step), frame.camera_name
        return DepthFrame(measured, sigma, everywhere, camera, frame.pose, frame.stamp_ns, name, _SURE), "true depth"

    return measure


def network_depth(ground: Dem, before: Dem, network: DepthNetwork, segmenter: Segmenter) -> Measure:
    """Return the depth of a network, fused with the terrain and surface of before as in the graph.

    A frame whose pose the fusion suspects has no depth."""
    to_ground, to_surface = (TerrainTracer(dem, possible=NOTHING_BEYOND) for dem in (ground, before))
    settings = FusionSettings()
    classes = ClassPriors.of(segmenter.labels, network.fusion)
    known: dict[tuple[str, int], tuple[DepthFrame, str]] = {}

    def measure(frame: TruthFrame) -> tuple[DepthFrame, str]:
        key = frame.camera_name, frame.stamp_ns
        if key not in known:
            camera, photo, labels = frame.camera, frame.photo, segmenter.segment(frame.photo).labels
            traced, canopy = (tracer.trace(camera, frame.pose) for tracer in (to_ground, to_surface))
            fused = fuse(
                traced, network.predict(photo, camera), photo, labels, classes, settings, canopy, network.fusion
            )
            own = fused.measured()
            of = camera, frame.pose, frame.stamp_ns, frame.camera_name, _SURE
            known[key] = DepthFrame.of_photo(own.depth, own.sigma, *of, labels), fused.verdict.value
        return known[key]

    return measure
