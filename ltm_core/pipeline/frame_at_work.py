"""Run the steps of a camera's frame without a graph: its votes, and its measurements for the terrain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ltm_core.base.named_columns import Columns
from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_core.fuel.vote_columns import no_columns, votes_to_columns
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep, TracingConfig, TracingStep, VotingStep, seen
from ltm_core.pipeline.fusing_step import FusingConfig, FusingStep
from ltm_core.site.site import Site
from ltm_core.vision.masks import Looking
from ltm_core.vision.scene_view import SceneView
from ltm_core.vision.segmenter import Segmentation


@dataclass(frozen=True)
class FrameVotes:
    """Votes of a frame: `columns` as in `vote_columns`; `reason`: why its image was not used, or empty."""

    columns: Columns
    reason: str


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """Depth measured for the terrain: `depth`, `sigma` (h, w) metres from the depth network, NaN where it measures
    nothing; `labels` (H, W) class ids. `trouble`: the error of the network, if it failed."""

    depth: Float32Array
    sigma: Float32Array
    labels: UInt8Array
    trouble: str = ""


class FrameSteps:
    """All steps for the frames of one camera; frames may come in any order, so smoke, which needs earlier images, is
    not detected. `fusing`: None if measurements are not needed."""

    def __init__(
        self,
        site: Site,
        camera: str,
        tracing: TracingConfig,
        labelling: LabellingConfig,
        fusing: FusingConfig | None = None,
    ) -> None:
        self.tracing = TracingStep(site, camera, tracing)
        self.labelling = LabellingStep(site, camera, labelling)
        self.voting = VotingStep(site, camera)
        self.fusing = None if fusing is None else FusingStep(site, camera, fusing)

    @property
    def described(self) -> str:
        """Return the name and checksum of the label network."""
        return self.labelling.described

    def of(self, frame: PosedImage) -> FrameAtWork:
        """Return the steps of a frame, for the requested results."""
        return FrameAtWork(self, frame)


class FrameAtWork:
    """Frame in the steps of its camera: each step runs once, when its result is first requested, so that votes do not
    depend on whether measurements are requested. Methods raise LtmError as the steps do."""

    def __init__(self, steps: FrameSteps, frame: PosedImage) -> None:
        self._steps, self._frame = steps, frame

    def votes(self, covariance: Float64Array | None) -> FrameVotes:
        """Return the votes. `covariance`: (6, 6) of the frame's pose; None: it is exact."""
        found, view = self._labelled
        if view.reason is not None:
            return FrameVotes(no_columns(), view.unusable)  # an image that shows nothing needs no ranges
        frame, voting = self._frame, self._steps.voting
        cast = voting.cast(self._depth, frame.camera, frame.pose, found, frame.stamp_ns, covariance)
        return FrameVotes(votes_to_columns(voting.carried(cast), voting.labels.names), view.unusable)

    def measured(self, covariance: Float64Array | None) -> MeasuredFrame:
        """Return the measurement of steps that fuse. `covariance`: (6, 6) of the frame's pose; None: unknown."""
        assert self._steps.fusing is not None  # nosec B101 # tells the type checker what holds
        found, view = self._labelled
        measured, trouble = self._steps.fusing.measure(self._depth, self._frame, found.labels, covariance, view)
        return MeasuredFrame(measured.depth, measured.sigma, found.labels, trouble)

    @cached_property
    def _labelled(self) -> tuple[Segmentation, SceneView]:
        frame = self._frame
        looking = Looking.of(frame.camera, frame.pose)
        return self._steps.labelling.label(frame.image, looking, frame.stamp_ns, in_order=False)

    @cached_property
    def _depth(self) -> Float32Array:
        """Return (H, W) traced, along the optical axis."""
        camera, pose, tracing = self._frame.camera, self._frame.pose, self._steps.tracing
        return seen(tracing.trace(camera, pose).ranges.depth(), tracing.hidden(camera, pose))
