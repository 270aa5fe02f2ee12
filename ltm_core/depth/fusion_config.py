"""Define the constants of depth fusion; read those of a network from the file beside its manifest.

A constant is *fitted* to rendered frames by `ltm-lab train fusion`, which writes it beside a depth network to
`<network>_fusion.yaml`, or *chosen* by the RMSE of `ltm-lab eval depth` on the development scenarios. Log odds are
natural logarithms of p / (1 - p)."""

from pathlib import Path
from typing import Any

from pydantic import Field

from ltm_core.base.strict_model import StrictModel
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.manifest import FUSION_SUFFIX, NetworkManifest


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

    grass: float = chosen(0.2, "Mean height in metres of the visible surface of grass above bare ground.", ge=0, lt=100)
    shrub: float = chosen(1.0, "Mean height in metres of the visible surface of shrub.", ge=0, lt=100)
    tree: float = chosen(6.0, "Mean height in metres of the visible surface of trees.", ge=0, lt=100)
    doubt: float = chosen(0.5, "Standard deviation of a cover height, as a share of it.")
    crest: float = chosen(3.0, "Maximum height in metres of unlabelled or low cover above a crest.")
    tree_crest: float = chosen(12.0, "Maximum height in metres of a tree above a crest.")
    bare_crest: float = chosen(1.0, "Maximum height in metres of bare ground and water above a crest.")


class SurfaceConfig(StrictModel):
    """Expected depth of the terrain and its sigma (`expected_surface`)."""

    jump: float = chosen(1.25, "Ratio of depths of neighbouring pixels above which they are on two surfaces.")
    most_roll_deg: float = chosen(20.0, "Maximum roll in degrees of a camera whose columns count as vertical.")
    most_pitch_deg: float = chosen(60.0, "Maximum pitch in degrees at which objects stand along columns.")
    pixel_doubt: float = chosen(0.3, "Displacement of an edge in pixels at a perfect pose, by pixels and DEM cells.")
    least_sigma: float = chosen(1e-3, "Minimum relative standard deviation.")


class SamplingConfig(StrictModel):
    """Selection of trustworthy terrain samples (`ground_sampling`)."""

    most: int = chosen(6000, "Maximum number of samples of a fit.")
    crowd: int = chosen(4, "Maximum number of samples of a half octave of ranges, in multiples of the median one.")
    grazing_deg: float = chosen(4.0, "Minimum angle between ray and ground in degrees.")
    unsure: float = chosen(0.3, "Relative standard deviation above which a depth is not used for the scale.")
    step: int = chosen(6, "Distance between candidates in pixels.")
    clear: int = chosen(5, "Minimum distance in pixels from edges of the terrain.")


class RegressionConfig(StrictModel):
    """Straight line through most samples (`scale_fit`)."""

    trials: int = chosen(128, "Number of pairs tried; 45 % outliers spoil all once in 10^19.", ge=1)
    scored: int = chosen(800, "Number of evenly spaced points that score the trials.", ge=8)
    band: float = chosen(2.5, "Robust standard deviations within which a point is an inlier.", gt=0)
    fewest: int = chosen(8, "Minimum number of points for a line.", ge=2)
    least_run: float = chosen(1e-3, "Minimum distance of a pair in x, as a share of the spread of x.")
    refined: int = chosen(3, "Number of rounds of least squares over the inliers.")


class ScaleConfig(StrictModel):
    """Scale and shift of a network's depth (`scale_fit`)."""

    least_samples: int = chosen(50, "Minimum number of samples of trustworthy ground for a scale.")
    least_positive: float = chosen(0.9, "Minimum share of positive values for a line without a shift.")
    least_inliers: float = chosen(0.3, "Minimum share of inliers for a usable fit.")
    least_explained: float = chosen(0.1, "Minimum share of the ground's spread that a network explains.")
    like_terrain: float = chosen(0.2, "Relative noise below which a network is usable even over ground of one depth.")
    shift_gain: float = chosen(0.6, "Share of the residual that a shift must reach.")
    typical_sigma: float = chosen(0.1, "Relative sigma of the terrain above which a sample has less weight.")
    relative_floor: float = chosen(2e-3, "Minimum relative noise of a network.")
    gross_sigmas: float = chosen(3.0, "Joint standard deviations above which a residual is a gross error.")
    covered_gross: float = chosen(0.5, "Share of the much too near pixels that are errors and not missed cover.")
    least_gross: float = chosen(0.003, "Minimum share of gross errors of a network.")
    noisy_gross: float = chosen(0.05, "Share of gross errors that noise alone may explain.")


class ErrorModelConfig(StrictModel):
    """Systematic errors and noise of a network by depth (`error_model`)."""

    fewest: int = chosen(10, "Minimum number of samples for a spread.")
    belief: float = chosen(1.0, "Weight of the spread of all ranges, in regions.")
    densest: float = chosen(0.4, "Share of the samples in the densest part, which replaces the median.")
    least_spread: float = chosen(0.5, "Minimum spread of one range, as a share of the spread of all ranges.")
    nearer_far: float = chosen(3.0, "Maximum bias towards the camera on far ground, in true inverse depths.")
    biased: float = chosen(0.3, "Share of a range's bias by which it varies within the half octave.")
    beyond: float = chosen(1.5, "Growth factor of the spread for each half octave beyond all samples.")
    before: float = chosen(1.1, "Growth factor for each half octave nearer than all samples.")
    least_said: float = chosen(0.25, "Minimum value of a network, as a share of the true inverse depth.")


class UpsamplingConfig(StrictModel):
    """Alignment of a network's depth with the photo's edges (`guided_upsampling`)."""

    radius: int = chosen(1, "Radius of the windows in pixels of the network.")
    edge: float = chosen(12.0, "Contrast in 8-bit steps above which a change of grey is an edge.")


class BoundaryConfig(StrictModel):
    """Location of the edge between two ridges in the photo (`occlusion_boundaries`)."""

    usual_crest: float = chosen(0.25, "Rise of crests in metres over which a cut's prior falls by e.")
    strip_px: int = chosen(60, "Maximum rise of an edge in pixels; larger cover of a near crest is an object.")
    sample_rows: int = chosen(8, "Number of rows of a side's colour sample.")
    sample_columns: int = chosen(4, "Number of columns to each side of the middle of the sample.")
    color_noise: float = chosen(16.0, "Minimum variance of a colour in squared 8-bit steps.")
    temper: float = chosen(0.6, "Exponent of a pixel's colour likelihood, because neighbours share texture.")
    most: float = chosen(8.0, "Maximum log likelihood of one pixel's colour.")
    need: float = chosen(1.0, "Minimum log odds of a cut against no cut.")
    blur: tuple[int, int] = chosen((5, 3), "Columns and rows over which the photo's colours are averaged.")


class OcclusionConfig(StrictModel):
    """Objects in front of the ground (`occlusion_prior`)."""

    standing: ClassLogOdds = fitted(
        ClassLogOdds(grass=-3.2, shrub=0.2, tree=2.7, bare=-3.2, water=-3.2, built=2.7, unlabelled=0.1),
        "Log odds that a place shows an object in front of the ground by its label.",
    )
    metre: float = fitted(0.14, "Decrease of the log odds per metre of height.")
    highest: float = chosen(30.0, "Height in metres above which the log odds do not decrease further.")


class DecisionConfig(StrictModel):
    """Choice between terrain and network for each pixel (`pixel_fusion`)."""

    disagree: float = chosen(0.4, "Squared standard deviations above which a disagreement is examined.")
    agree: float = chosen(9.0, "Squared standard deviations up to which both depths are averaged.")
    torn: float = chosen(0.15, "Relative sigma above which the terrain is not averaged.")
    soft: float = chosen(0.15, "Tolerance of a pixel between its neighbours, as a share of their range of depths.")
    likelihood_weight: float = fitted(0.44, "Weight of the log likelihood of a nearer object.")
    canopy_weight: float = fitted(0.18, "Weight of the log likelihood of the canopy in a raster.")
    canopy: ClassLogOdds = fitted(
        ClassLogOdds(grass=-1.5, shrub=1.1, tree=1.6, bare=-2.6, water=-3.0, built=1.6, unlabelled=0.0),
        "Log odds of a canopy raster against bare ground where the two differ.",
    )
    open: float = chosen(0.1, "Probability above which the less likely depth also counts; 0.5: never.")
    elsewhere: float = chosen(4.0, "Variance of a network on objects, in multiples of its variance on ground.")
    between: float = chosen(0.3, "Sigma of a pixel's depth as a share of its neighbours' range.")
    ranges: float = chosen(3.0, "Number of e-foldings of depth over which an object is equally likely.")
    measured: float = chosen(0.5, "Relative standard deviation above which a network's depth is no measurement.")


class PoseCheckConfig(StrictModel):
    """Check that the terrain matches the photo (`pose_check`)."""

    reach_deg: float = chosen(2.5, "Range in degrees of the search for a better pose.")
    cells: int = chosen(480, "Number of columns of the contrast image.")
    least_edges: int = chosen(60, "Minimum number of terrain edges for the check.")
    most_edges: int = chosen(1500, "Maximum number of edges used.")
    near_deg: float = chosen(0.25, "Maximum displacement in degrees of an edge by cover and the DEM.")
    allowed_deg: float = chosen(0.13, "Tolerated turn in degrees, in addition to three sigmas.")
    cover: float = chosen(1.0, "Height in metres by which cover raises a crest.")
    beside: int = chosen(2, "Distance in pixels above an edge at which the label of its cover is read.")
    as_well: float = chosen(0.8, "Share of the best contrast over the usual one above which a pose is about as good.")
    clearly: float = chosen(0.6, "Share of the best contrast below which the given pose is suspected.")
    contrast: float = chosen(1.8, "Minimum contrast at the best place.")
    outstanding: float = chosen(4.0, "Minimum excess of the best contrast over the usual one, in spreads.")


class FusionConfig(StrictModel):
    """All constants of TopoDepth's fusion. Sigmas of the inputs are in `expected_surface.FusionSettings`."""

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


def fusion_path(manifest: NetworkManifest) -> Path:
    """Return the path of the constants fitted with a network."""
    return manifest.folder / f"{manifest.name}{FUSION_SUFFIX}"


def load_fusion_config(manifest: NetworkManifest) -> FusionConfig:
    """Return the constants beside a manifest, or the defaults. Raises ConfigError for an invalid file."""
    path = fusion_path(manifest)
    return load_yaml(path, FusionConfig) if path.is_file() else FusionConfig()
