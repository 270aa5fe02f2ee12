"""Sections of photos with a pose and a DEM: traced and fused depth, labels, and terrain change, against surveys."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, RgbImage, UInt8Array
from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.depth.topodepth import FusedDepth, fuse
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.range_image import RangeImage
from ltm_core.pose_estimation.points.resection import Resection, resect, traced_errors
from ltm_core.raster.dem import Dem
from ltm_core.storage.image_io import read_rgb
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.gallery.exhibit import Exhibit, Fact, Section
from ltm_lab.evaluation.gallery.label_facts import VEGETATION, called, facts_of_areas, share_called, whole_picture
from ltm_lab.evaluation.gallery.parts import Part
from ltm_lab.evaluation.gallery.real_photos_io import (
    ENGABREEN_PHOTOS,
    canyon_areas,
    read_engabreen_points,
    read_glacier,
)
from ltm_lab.evaluation.pictures.surface_change import surface_sheet
from ltm_lab.evaluation.terrain.canyon_io import PHOTOS, Canyon, read_canyon
from ltm_lab.evaluation.terrain.canyon_score import AFTER, BEFORE, RULES, CanyonScore, score_canyon

STEP = 3
"""Factor by which the photos are reduced after the networks have seen them: 1430 and 1296 columns."""
ENGABREEN_POSITION = (722.0, 671.0, 770.0)
ENGABREEN_STATED = Camera(4290, 2856, 30 / 22.0 * 4290, 30 / 22.0 * 4290, 2144.5, 1427.5)
"""As the source states them: 30 mm on a sensor 22.0 mm wide; nothing is known of the angles."""
LARGE_CHANGE = 1.5
"""Change of height in metres that is certainly not small."""
_CALIBRATION = float(np.radians(0.03))

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Networks:
    """The label and the depth network of a gallery."""

    segmenter: Segmenter
    depth: DepthNetwork

    @classmethod
    def open(cls, labels: str, depth: str) -> "Networks":
        """By name or manifest. Raises ModelError."""
        return cls(Segmenter.open(labels), DepthNetwork.open(depth))

    @property
    def names(self) -> LabelSet:
        return self.segmenter.labels


@dataclass(frozen=True, eq=False)
class Posed:
    """A photo through the chain, every STEP-th pixel of each image; as the graph makes it."""

    photo: RgbImage
    labels: UInt8Array
    traced: RangeImage
    fused: FusedDepth

    @classmethod
    def of(cls, photo: RgbImage, fit: Resection, tracer: TerrainTracer, networks: Networks) -> "Posed":
        """Trace, label and fuse a photo of the resected camera's size."""
        labels = np.ascontiguousarray(networks.segmenter.segment(photo).labels[::STEP, ::STEP])
        network = networks.depth.predict(photo, fit.camera)
        small = np.ascontiguousarray(photo[::STEP, ::STEP])
        traced = tracer.trace(fit.camera.scaled(STEP), fit.pose)
        angle = float(np.sqrt(_CALIBRATION**2 + np.diag(fit.pose_covariance)[3:].max()))
        settings = FusionSettings(angle)
        classes, constants = ClassPriors.of(networks.names, networks.depth.fusion), networks.depth.fusion
        return cls(small, labels, traced, fuse(traced, network, small, labels, classes, settings, config=constants))

    def facts(self, names: LabelSet) -> list[Fact]:
        """What can be said of it without a survey."""
        depth, fused = self.traced.depth(), self.fused
        land = (self.labels != Label.SKY) & (self.labels != UNLABELLED)
        info = fused.info()["share"]
        return [
            Fact("verdict of the fusion", f"{fused.verdict}{f': {fused.reason}' if fused.reason else ''}"),
            Fact("pixels traced to terrain", float(np.isfinite(depth).mean()), "%"),
            Fact("traced as unknown", float(np.isnan(depth).mean()), "%"),
            Fact("traced as sky", float(np.isposinf(depth).mean()), "%"),
            Fact("traced as sky where the labels see land", float((np.isposinf(depth) & land).mean()), "%"),
            Fact("fused depth from", ", ".join(f"{name} {share:.0%}" for name, share in info.items())),
            whole_picture(self.labels, names),
        ]


def engabreen_section(data: Path, networks: Networks, progress: Progress) -> Section:
    """Both photos of the glacier on its lidar DEM. Raises LtmError where they cannot be read or resected."""
    dem, ice = read_glacier(data)
    tracer = TerrainTracer(dem)
    fit = resect(read_engabreen_points(data), ENGABREEN_STATED, ENGABREEN_POSITION, bend=tracer.bend)
    exhibits = []
    for name in ENGABREEN_PHOTOS:
        progress(name)
        made = Posed.of(read_rgb(data / Part.ENGABREEN.folder / name), fit, tracer, networks)
        facts = made.facts(networks.names)
        if name == ENGABREEN_PHOTOS[0]:
            facts += _control_point_facts(fit, tracer, made.fused.depth)
        else:
            facts.append(Fact("pose", f"that of {ENGABREEN_PHOTOS[0]}, as if the camera had not moved in between"))
        on_ice, on_rock = _on_ice(made.traced, ice)
        green = share_called(made.labels, on_ice, VEGETATION)
        facts += [
            Fact("ice that is called vegetation", green, "%"),
            Fact("ice is called", called(made.labels, on_ice, networks.names.names)),
            Fact("ground without ice is called", called(made.labels, on_rock, networks.names.names)),
        ]
        truth = np.where(on_ice, np.uint8(Label.BARE), np.uint8(UNLABELLED))
        depth = made.traced.depth()
        exhibits.append(
            Exhibit(Path(name).stem, made.photo, made.labels, tuple(facts), green, truth, depth, made.fused)
        )
    return Section(
        "Engabreen",
        "Both photos of the folder.",
        "ice that is called vegetation",
        "Time-lapse photos of a Norwegian glacier, a 3 m lidar DEM of the day of the first, 14 surveyed control points "
        "of the first, and a mask of the ice. There is no class for ice: bare counts as right, and so is it drawn. The "
        "depth network was chosen with a look at this glacier.",
        tuple(exhibits),
    )


def canyon_section(data: Path, networks: Networks, progress: Progress) -> Section:
    """The first and the last photo of the canyon, on the survey before them; and the change that three photos show.
    Raises LtmError where they cannot be read or resected."""
    canyon = read_canyon(data / Part.CANYON.folder)
    fit = canyon.resection
    tracer = TerrainTracer(canyon.surveys[BEFORE])
    exhibits = []
    for date in (min(PHOTOS), max(PHOTOS)):
        progress(PHOTOS[date])
        made = Posed.of(canyon.photo(date, 1), fit, tracer, networks)
        truth = canyon_areas(date, made.labels.shape)
        of_areas, fault = facts_of_areas(made.labels, truth, networks.names.names)
        surveyed = TerrainTracer(canyon.surveys[date]).trace(made.traced.camera, fit.pose).depth()
        facts = [
            *made.facts(networks.names),
            *_survey_facts("traced on the older survey", made.traced.depth(), surveyed),
            *_survey_facts("fused", made.fused.depth, surveyed),
            *of_areas,
        ]
        depth = made.traced.depth()
        exhibits.append(Exhibit(date, made.photo, made.labels, tuple(facts), fault, truth, depth, made.fused))
    progress("change")
    measured, ideal = score_canyon(canyon, networks.depth), score_canyon(canyon, None)
    return Section(
        "Canyon",
        "The first and the last of the three photos.",
        "wrong, of the land named by hand",
        f"One USGS camera over a sandbar of the Colorado, its photos of three years on the 1 m survey of {BEFORE} "
        "(yymmdd), against surveys of the photos' days. Only the bar is surveyed: the walls, the river and the far "
        "bank are unknown. The control points are coarse. The photo of 130922 taught the label network; that of 150924 "
        "did not, but its view did.",
        tuple(exhibits),
        (
            Fact("control points, median residual", float(np.median(fit.residual_px)), "px"),
            *_change_facts("depth from the network", measured, canyon),
            *_change_facts("depth from each day's own survey, which the geometry would allow", ideal, canyon),
        ),
        (("Change from the network's depth", _sheet(measured)), ("Change from ideal depth", _sheet(ideal))),
    )


def _control_point_facts(fit: Resection, tracer: TerrainTracer, fused: Float32Array) -> list[Fact]:
    found = traced_errors(fit, tracer)
    seen = found.visible
    u, v = np.rint(fit.points.pixels / STEP).astype(int).T
    off = fused[v, u] - fit.pose.to_optical(fit.points.places)[:, 2]
    return [
        Fact("control points", len(fit.points.names)),
        Fact("traced to surveyed place, median", float(np.median(found.errors)), "m"),
        Fact("of those that the DEM does not hide, median", float(np.median(found.errors[seen])), "m"),
        Fact("of all, worst", float(found.errors.max()), "m"),
        Fact("fused depth off at control points, median", _median(np.abs(off)), "m"),
        Fact("fused depth off at control points, worst", float(np.nanmax(np.abs(off))), "m"),
    ]


def _on_ice(traced: RangeImage, ice: Dem) -> tuple[BoolArray, BoolArray]:
    points = traced.points()
    seen = np.isfinite(points[..., 0])
    row, col = ice.geometry.cell_of(np.where(seen, points[..., 0], 0), np.where(seen, points[..., 1], 0))
    seen &= ice.geometry.contains(row, col)
    frozen = np.zeros(seen.shape, np.bool_)
    frozen[seen] = ice.elevation[row[seen], col[seen]] > 0.5
    return frozen, seen & ~frozen


def _survey_facts(name: str, depth: Float32Array, surveyed: Float32Array) -> list[Fact]:
    """Depth against that of the photo's own day, where both are known."""
    both = np.isfinite(depth) & np.isfinite(surveyed)
    off = np.abs(depth[both] - surveyed[both])
    return [
        Fact(f"{name}, off the day's own survey, median", _median(off), "m"),
        Fact(f"{name}, the same, 95th percentile", float(np.percentile(off, 95)) if off.size else float("nan"), "m"),
    ]


def _change_facts(name: str, score: CanyonScore, canyon: Canyon) -> list[Fact]:
    change = np.abs(canyon.surveys[AFTER].elevation - canyon.surveys[BEFORE].elevation)
    large = np.nan_to_num(change) > LARGE_CHANGE
    seen, found = score.layers.observed, score.layers.change > 0
    verdicts = f" ({', '.join(score.verdicts)})" if any(score.verdicts) else ""
    return [
        Fact(f"{name}{verdicts}: cells seen", score.change.cells),
        Fact(f"cells changed by {RULES.threshold:g} m or more", int(score.truth.sum())),
        Fact("of these found", score.change.hits),
        Fact("found falsely", score.change.false_alarms),
        Fact(f"cells changed by more than {LARGE_CHANGE:g} m", int(large.sum())),
        Fact("of these seen", int((large & seen).sum())),
        Fact("of these found", int((large & found).sum())),
    ]


def _sheet(score: CanyonScore) -> RgbImage:
    layers = score.layers
    moved = layers.height - layers.reference
    return surface_sheet(
        layers.height, layers.sigma, moved, layers.change, layers.observed, layers.geometry, score.truth
    )


def _median(values: Float64Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")
