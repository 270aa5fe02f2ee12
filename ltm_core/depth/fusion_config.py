"""Define the constants of depth fusion; read those of a network from the file beside its manifest.

Each constant has one of three origins: *derived* from geometry or arithmetic, with no choice left; *fitted* to
rendered frames by `ltm-lab train fusion`, which writes them beside a depth network as `<network>_fusion.yaml`; or
*chosen* on the development scenarios by the RMSE of `ltm-lab eval depth`.

Log odds are natural logarithms of p / (1 - p).
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field

from ltm_core.base.strict_model import StrictModel
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.manifest import FUSION_SUFFIX, NetworkManifest


def derived(default: Any, meaning: str, **bounds: float) -> Any:
    """Declare a constant that follows from others; `bounds` as in pydantic, for example ge=0."""
    return Field(default, description=meaning, json_schema_extra={"origin": "derived"}, **bounds)  # type: ignore[call-overload]


def fitted(default: Any, meaning: str) -> Any:
    """Declare a constant that `ltm-lab train fusion` writes."""
    return Field(default, description=meaning, json_schema_extra={"origin": "fitted"})


def chosen(default: Any, meaning: str, **bounds: float) -> Any:
    """Declare a constant chosen on the development scenarios; `bounds` as in pydantic, for example ge=0."""
    return Field(default, description=meaning, json_schema_extra={"origin": "chosen"}, **bounds)  # type: ignore[call-overload]


class ClassLogOdds(StrictModel):
    """Log odds by the label of a place."""

    grass: float = fitted(..., "grass")
    shrub: float = fitted(..., "shrub")
    tree: float = fitted(..., "trees")
    bare: float = fitted(..., "bare ground and rock")
    water: float = fitted(..., "water")
    built: float = fitted(..., "buildings")
    unlabelled: float = fitted(..., "no label")


class CoverConfig(StrictModel):
    """Vegetation heights by class."""

    grass: float = chosen(0.2, "metres by which the visible surface of grass stands above bare ground", ge=0, lt=100)
    shrub: float = chosen(
        1.0, "the same of shrub, somewhat below the plants' own height: one looks between them too", ge=0, lt=100
    )
    tree: float = chosen(6.0, "the same of trees", ge=0, lt=100)
    doubt: float = chosen(0.5, "sigma of a cover height as a part of it")
    crest: float = chosen(3.0, "metres that unlabelled or low cover may rise over a crest")
    tree_crest: float = chosen(12.0, "metres that a tree may rise over a crest")
    bare_crest: float = chosen(1.0, "metres that bare ground and water may: the raster rounds crests off")


class SurfaceConfig(StrictModel):
    """Expected depth of the terrain and its sigma (`expected_surface`)."""

    jump: float = chosen(1.25, "ratio of depths of neighbouring pixels from which on they lie on two surfaces")
    most_roll_deg: float = chosen(20.0, "roll of a camera whose columns are still about plumb")
    most_pitch_deg: float = chosen(60.0, "pitch, up or down, of a camera along whose columns things still stand")
    pixel_doubt: float = chosen(0.3, "pixels by which an edge may be misplaced at a perfect pose: grid and DEM cells")
    least_sigma: float = chosen(1e-3, "least relative sigma that is claimed")


class SamplingConfig(StrictModel):
    """Selection of trustworthy terrain samples (`ground_sampling`)."""

    most: int = chosen(6000, "samples that a fit gets at most")
    crowd: int = chosen(4, "times the places of a middling half octave of ranges that one may have")
    grazing_deg: float = chosen(4.0, "least angle between ray and ground")
    unsure: float = chosen(0.3, "relative sigma from which on a depth says nothing of scale")
    step: int = chosen(6, "pixels between candidates")
    clear: int = chosen(5, "pixels within which no edge of the terrain may lie")


class RegressionConfig(StrictModel):
    """Straight line through most samples (`robust_regression`)."""

    trials: int = derived(128, "pairs tried: with 45 % outliers one is clean with 0.3, so all fail once in 10^19", ge=1)
    scored: int = chosen(800, "points, evenly taken, that score the trials; the inliers come from all", ge=8)
    band: float = chosen(2.5, "robust standard deviations within which a point is an inlier", gt=0)
    fewest: int = chosen(8, "points below which no line is laid", ge=2)
    least_run: float = derived(1e-3, "of x's spread: pairs that lie closer give no slope")
    refined: int = chosen(3, "rounds of least squares over the inliers")


class ScaleConfig(StrictModel):
    """Scale and shift of a network's depth (`scale_fit`, `robust_regression`)."""

    least_samples: int = chosen(50, "of trustworthy ground below which no scale is fitted")
    least_positive: float = chosen(0.9, "of a relative network's values: below, it has no line without a shift")
    least_inliers: float = chosen(0.3, "share of samples below which nothing holds together")
    least_explained: float = chosen(0.1, "part of the ground's spread in inverse depth that a network must explain")
    like_terrain: float = chosen(0.2, "relative noise below which it is of use even over ground of one depth")
    shift_gain: float = chosen(0.6, "of the residual: a shift must bring it below, for it rules all that is far")
    typical_sigma: float = chosen(0.1, "relative sigma of the terrain from which on a sample counts for less")
    relative_floor: float = chosen(2e-3, "least relative noise of a network that is believed")
    gross_sigmas: float = chosen(3.0, "joint sigmas beyond which a residual is no noise")
    covered_gross: float = chosen(0.5, "part of what is seen much too near that is an error, and no missed cover")
    least_gross: float = chosen(0.003, "least share of gross errors that a network is believed to make")
    noisy_gross: float = chosen(0.05, "the share that noise alone may raise it to: few places are many samples")


class ErrorModelConfig(StrictModel):
    """Systematic errors and noise of a network by region and depth (`error_model`)."""

    regional: bool = chosen(True, "whether corrections differ over the photo, where held-out regions bear them out")
    by_depth: bool = chosen(True, "whether bias and spread differ by range")
    unsampled: float = chosen(4.0, "variance of a region without samples, in that of regions held out")
    shrink: tuple[float, ...] = chosen((4.0, 16.0, 64.0), "samples' worth of belief in no correction, tried in turn")
    gain: float = chosen(0.97, "of the held-out error: corrections that do not reach it are left out")
    winsor: float = chosen(6.0, "sigmas at which residuals are cut off")
    covered: float = chosen(4.0, "sigmas nearer than the terrain: cover that no label told of, not an error")
    blur: tuple[float, float, float] = chosen((1.0, 1.0, 1.5), "regions and half octaves over which tables are smooth")
    peak: float = derived(0.15, "about what a cell smoothed by `blur` keeps of its own")
    fewest: int = chosen(10, "samples of which a spread is taken")
    belief: float = chosen(1.0, "regions' worth of it in the spread of all ranges")
    densest: float = chosen(
        0.4, "of the samples, that lie closest together: objects in most places would bias a median"
    )
    least_spread: float = chosen(0.5, "of the spread of all ranges, that of one")
    nearer: float = chosen(12.0, "times nearer than the ground: no error, but something right before the camera")
    nearer_far: float = chosen(3.0, "times nearer: far ground of unknown range is seen at some middling one")
    biased: float = chosen(0.3, "of a range's bias, by which that differs within the half octave")
    beyond: float = chosen(1.5, "growth of the spread with each half octave beyond all samples")
    before: float = chosen(1.1, "the same before all samples: what is near is known by what is farther")
    least_said: float = chosen(0.25, "of the true inverse depth, that a network is taken to say at least")


class UpsamplingConfig(StrictModel):
    """Alignment of a network's depth with the photo's edges (`guided_filter`)."""

    radius: int = chosen(1, "of the windows, pixels of the network")
    edge: float = chosen(12.0, "contrast in 8-bit steps from which on a change of grey counts as an edge")


class BoundaryConfig(StrictModel):
    """Location of the edge between two ridges in the photo (`occlusion_boundaries`)."""

    usual_crest: float = chosen(0.25, "metres by which crests are usually raised: a cut's prior falls by e for each")
    strip_px: int = chosen(60, "most pixels that an edge is raised: a near crest's cover is an object")
    strip_cells: float = chosen(6.0, "the same in rows of a network's depth, where there is one")
    sample_rows: int = chosen(8, "rows of a side's colour sample")
    sample_columns: int = chosen(4, "columns to each side of its middle")
    color_noise: float = chosen(16.0, "least variance of a colour, squared 8-bit steps")
    temper: float = chosen(0.6, "of a pixel's colour likelihood: neighbours share texture")
    most: float = chosen(8.0, "log likelihood that one pixel's colour may carry")
    network_most: float = chosen(3.0, "the same of its network depth")
    network_sure: float = chosen(1.0, "log likelihood from which on the network may raise an edge beyond usual cover")
    need: float = chosen(1.0, "log odds by which a cut must be better than none")
    blur: tuple[int, int] = chosen((5, 3), "columns and rows over which the photo's colours are averaged")
    outline: ClassLogOdds = fitted(
        ClassLogOdds(grass=-0.9, shrub=0.6, tree=1.3, bare=-1.7, water=-1.7, built=1.3, unlabelled=0.4),
        "log odds that a pixel a metre above a crest, which the colours give to it, belongs to it",
    )
    toward: float = fitted(1.9, "log odds more where the network sees it as near as the crest, less where as far")


class OcclusionConfig(StrictModel):
    """Objects in front of the ground (`occlusion_prior`)."""

    standing: ClassLogOdds = fitted(
        ClassLogOdds(grass=-3.2, shrub=0.2, tree=2.7, bare=-3.2, water=-3.2, built=2.7, unlabelled=0.1),
        "log odds that a place shows what stands before the ground, where all labels about it are of a class",
    )
    metre: float = fitted(0.14, "log odds less with each metre of height")
    highest: float = chosen(30.0, "metres from which on they fall no more")
    no_foot: float = fitted(1.0, "log odds less where the image ends above the foot")
    about: int = chosen(7, "cells of the network's depth, the side of the square whose labels count")


class DecisionConfig(StrictModel):
    """Choice between terrain and network for each pixel (`pixel_fusion`, `fusion_rows`)."""

    disagree: float = chosen(0.4, "squared sigmas from which on a disagreement is looked at")
    agree: float = chosen(9.0, "squared sigmas up to which both are averaged")
    torn: float = chosen(0.15, "relative sigma of a terrain that is torn between two surfaces: no mean is there")
    soft: float = chosen(0.15, "of the range of depths among neighbours: how far off a pixel between them may be")
    likelihood_weight: float = fitted(0.44, "of the log likelihood of something nearer: errors go on for many pixels")
    canopy_weight: float = fitted(0.18, "the same of a canopy raster")
    canopy: ClassLogOdds = fitted(
        ClassLogOdds(grass=-1.5, shrub=1.1, tree=1.6, bare=-2.6, water=-3.0, built=1.6, unlabelled=0.0),
        "log odds that a canopy raster, and not bare ground, is what shows where the two differ",
    )
    open: float = chosen(0.1, "chance from which on a depth counts beside the likelier one; 0.5: none does")
    elsewhere: float = chosen(4.0, "times a network's variance on ground: that on what stands before it")
    between: float = chosen(0.3, "of the range of depths among neighbours: sigma of which of them a pixel shows")
    blurred: float = chosen(0.3, "of a disagreement: what lies between two sides by more is an edge")
    ranges: float = chosen(3.0, "e-foldings of depth over which what stands may be, each as likely")
    measured: float = chosen(0.5, "relative sigma from which on a network's own depth measures nothing")


class PoseCheckConfig(StrictModel):
    """Check that the terrain matches the photo (`pose_check`, `skyline_check`)."""

    enabled: bool = chosen(True, "whether a pose that contradicts the photo stops fusion")
    reach_deg: float = chosen(2.5, "how far a wrong pose is looked for")
    cells: int = chosen(480, "columns of the contrast image")
    least_edges: int = chosen(60, "edges of the terrain below which they say nothing")
    most_edges: int = chosen(1500, "edges that are looked at")
    near_deg: float = chosen(0.25, "angle that cover and the DEM's error may move an edge by: nearer ones are left out")
    allowed_deg: float = chosen(0.13, "turn that is no surprise, beside three sigmas of the direction")
    cover: float = chosen(1.0, "metres that cover raises a crest by")
    beside: int = chosen(2, "pixels above an edge where the label of what stands on it is read")
    as_well: float = chosen(0.8, "of the best contrast over the usual: about as good")
    clearly: float = chosen(0.6, "of the best contrast that the given pose must miss to be suspected")
    contrast: float = chosen(1.8, "least contrast at the best place")
    outstanding: float = chosen(4.0, "spreads by which that is above the usual one")
    skyline_gain: float = chosen(4.0, "times that the skyline must fit better: labels that err fit better somewhere")
    skyline_as_well: float = chosen(1.25, "times the skyline's best cost: about as good, with a margin")
    skyline_margin: float = chosen(0.25, "that margin, mean square of sigmas")
    columns: int = chosen(480, "columns, about, in which the skyline is looked at")
    least_share: float = chosen(0.3, "of them with a known skyline beyond near crests: short pieces fit anywhere")
    edge: float = chosen(0.75, "sigma of the labels' edge, in steps between columns or cells of their network")
    run: int = chosen(3, "rows of land that end the sky")
    most: float = chosen(4.0, "sigmas beyond which a column counts no more: labels err, clouds hide")
    share: float = chosen(0.6, "of the columns that must still be seen after a shift")
    hopeless: float = chosen(3.0, "mean square of sigmas at the best place: then nothing fits")
    lucky: float = chosen(0.5, "mean square of sigmas below which a fit is no better but by luck")


class FusionConfig(StrictModel):
    """All constants of TopoDepth's fusion. Sigmas of the inputs are in `topodepth.FusionSettings`."""

    pose_check: PoseCheckConfig = PoseCheckConfig()
    cover: CoverConfig = CoverConfig()
    surface: SurfaceConfig = SurfaceConfig()
    sampling: SamplingConfig = SamplingConfig()
    regression: RegressionConfig = RegressionConfig()
    scale: ScaleConfig = ScaleConfig()
    error_model: ErrorModelConfig = ErrorModelConfig()
    upsampling: UpsamplingConfig = UpsamplingConfig()
    boundaries: BoundaryConfig = BoundaryConfig()
    occlusion: OcclusionConfig = OcclusionConfig()
    decision: DecisionConfig = DecisionConfig()

    def constants(self) -> Iterator[tuple[str, Any, str, str]]:
        """Iterate over dotted name, value, origin and meaning of every constant."""
        yield from _constants(self, "")

    def updated(self, changes: dict[str, Any]) -> FusionConfig:
        """Return a copy with other values by dotted name; all types and bounds are checked. Raises ValueError."""
        content = self.model_dump()
        for name, value in changes.items():
            *path, last = name.split(".")
            place = content
            for part in path:
                place = place[part]
            place[last] = value
        return FusionConfig.model_validate(content)


def _constants(model: BaseModel, prefix: str) -> Iterator[tuple[str, Any, str, str]]:
    for name, info in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from _constants(value, f"{prefix}{name}.")
        else:
            extra = info.json_schema_extra
            assert isinstance(extra, dict)  # nosec B101 # tells the type checker what holds
            yield f"{prefix}{name}", value, str(extra["origin"]), info.description or ""


def fusion_path(manifest: NetworkManifest) -> Path:
    """Return the path of the constants fitted with a network."""
    return manifest.folder / f"{manifest.name}{FUSION_SUFFIX}"


def load_fusion_config(manifest: NetworkManifest) -> FusionConfig:
    """Return the constants beside a manifest, or the defaults. Raises ConfigError for an invalid file."""
    path = fusion_path(manifest)
    return load_yaml(path, FusionConfig) if path.is_file() else FusionConfig()


def write_fusion_config(path: Path, config: FusionConfig, source: str) -> None:
    """Write every constant, each with its origin and meaning. `source`: how the fitted ones were found, in words."""
    lines = [f"# Constants of depth fusion (ltm_core/depth/fusion_config.py). Fitted ones by: {source}"]
    before: list[str] = []
    for group, constants in groupby(config.constants(), key=lambda c: c[0].rpartition(".")[0]):
        parts = group.split(".")
        shared = sum(1 for a, b in zip(before, parts, strict=False) if a == b)
        lines += [f"{'  ' * depth}{parts[depth]}:" for depth in range(shared, len(parts))]
        before = parts
        for name, value, origin, meaning in constants:
            text = f"{'  ' * len(parts)}{name.rpartition('.')[2]}: {json.dumps(value)}"
            lines.append(f"{text:<28} # {origin}; {meaning}")
    if path.is_symlink():  # to another network's: that one keeps its own
        path.unlink()
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
