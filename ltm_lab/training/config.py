"""Typed configuration of a training run; YAML overrides these defaults."""

from collections.abc import Iterable
from pathlib import Path

from pydantic import Field, model_validator

from ltm_core.base.strict_model import StrictModel
from ltm_core.vision.manifest import Withdrawal


class SplitConfig(StrictModel):
    """Whole sets (folders of frames of one scene, or of photos) held out: `validation` picks the weights and the
    temperature, `test` gives the scores.

    Without validation sets the last weights are kept. All other sets train the network. No frame of one scene is
    ever in two parts, so the scores are of unseen ground.
    """

    validation: tuple[str, ...] = ()
    test: tuple[str, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _parts_are_apart(self) -> "SplitConfig":
        both = sorted(set(self.validation) & set(self.test))
        if both:
            raise ValueError(f"{', '.join(both)} is in validation and in test; scenes must be in one part")
        return self


class NetworkConfig(StrictModel):
    """Channels of the pyramid over the Lite0 encoder, and whether the encoder starts from ImageNet's weights."""

    width: int = Field(default=64, ge=16, multiple_of=16)
    pretrained: bool = True
    fixed: int = Field(default=5, ge=0, le=16)  # blocks of the encoder, the first, that are never trained
    own_depth: bool = False  # depth reads a pyramid of its own
    side: bool = False  # coarser decoder maps add to the logits
    scene: bool = False  # a network of everyday scenes adds to the logits

    def with_parts_of(self, weights: Iterable[str]) -> "NetworkConfig":
        """This form with the optional parts that weights of these names belong to, and no others."""
        names = list(weights)
        parts = {"own_depth": "own.", "side": "side.", "scene": "scene."}
        return self.model_copy(
            update={part: any(name.startswith(prefix) for name in names) for part, prefix in parts.items()}
        )


class OptimiserConfig(StrictModel):
    steps: int = Field(default=2000, ge=1)
    batch: int = Field(default=8, ge=1)
    small: float = Field(default=0.6, ge=0, le=1)  # share of the steps, the first, at two thirds of the size
    frozen: float = Field(default=0.15, ge=0, le=1)  # share of the steps, the first, that leave the encoder as it is
    learning_rate: float = Field(default=2.0e-3, gt=0)
    encoder_rate: float = Field(default=0.2, ge=0, le=1)  # the encoder's learning rate relative to the heads'
    warmup: float = Field(default=0.05, ge=0, lt=1)  # share of the steps
    weight_decay: float = Field(default=0.02, ge=0)
    average: float = Field(default=0.99, ge=0, lt=1)  # decay of the running average of weights that is kept
    class_weight_power: float = Field(default=0.35, ge=0, le=1)  # weight = (1 / share of pixels) ** power
    label_smoothing: float = Field(default=0.02, ge=0, lt=0.5)
    # What is known of pixels without a class: ground of unknown cover is no sky, a far slope neither sky, water nor
    # built. Weight of that knowledge, below 1 because haze makes the farthest ranges look like sky.
    partial: float = Field(default=0.3, ge=0)
    depth: float = Field(default=0.4, ge=0)  # weight of true inverse depth
    order: float = Field(default=0.1, ge=0)  # weight of a teacher's order of near and far
    # Weight of staying, in depth, with the weights that a run starts from; in the place of `depth` and `order`.
    keep_depth: float = Field(default=0.0, ge=0)
    keep_labels: float = Field(default=0.0, ge=0)  # likewise of staying, in labels, at pixels of unknown class
    validate_every: int = Field(default=200, ge=1)
    # Processes that make batches ahead, 0: none. What is in a batch does not depend on it. A GPU needs eight or more.
    workers: int = Field(default=0, ge=0, le=64)


class AugmentConfig(StrictModel):
    """Chance of each change to a training frame; their strengths stand beside their code in `augment`."""

    flip: float = 0.5
    rescale: float = 0.7
    new_sky: float = 0.3
    photo_look: float = 0.3  # of rendered frames, where photos train too
    photo_sky: float = 0.0  # of any frame, where photos train too: the sky of one of them
    lent_ground: float = 0.0  # of photos: a patch of a rendered frame's ground
    lake: float = 0.0
    structures: float = 0.0  # masts, huts, dishes, roofs drawn into it
    shade: float = 0.0  # of frames with bare ground: part of it in grey or blue shade
    ground_tint: float = 0.2
    snow: float = 0.08
    haze: float = 0.25
    light: float = 0.65
    grey: float = 0.04
    blur: float = 0.12
    noise: float = 0.35
    jpeg: float = 0.3


class TrainingConfig(StrictModel):
    """One training run: data split, network, optimiser, augmentation, and what the exported model is called."""

    name: str
    frames: Path | None = None  # folder of <set>/NAME.png and NAME_labels.png; the command line may give it
    seed: int = 0
    width: int = Field(default=384, ge=64, multiple_of=32)  # of the windows that are trained on
    height: int = Field(default=256, ge=64, multiple_of=32)
    deploy_width: int = Field(default=512, ge=64, multiple_of=32)  # of the exported network's input
    deploy_height: int = Field(default=288, ge=64, multiple_of=32)
    split: SplitConfig
    shares: dict[str, float] = Field(default_factory=dict)  # set -> its share of the windows; the rest by frames
    network: NetworkConfig = NetworkConfig()
    optimiser: OptimiserConfig = OptimiserConfig()
    augment: AugmentConfig = AugmentConfig()
    offsets: dict[str, float] = Field(default_factory=dict)  # of the exported network's logits: see manifest.OutputSpec
    redness: dict[str, float] = Field(default_factory=dict)  # likewise
    withdraw: Withdrawal = Withdrawal()  # likewise
    heads_of: str = ""  # of the exported manifests: see manifest.NetworkManifest; depth: that name with `_depth`
    licence: str = "Apache-2.0"

    @model_validator(mode="after")
    def _shares_fit(self) -> "TrainingConfig":
        if sum(self.shares.values()) > 1 or any(share <= 0 for share in self.shares.values()):
            raise ValueError(f"shares are {self.shares}, expected values above 0 whose sum is at most 1")
        held_out = sorted(set(self.shares) & {*self.split.validation, *self.split.test})
        if held_out:
            raise ValueError(f"shares names {', '.join(held_out)}, held out by split")
        return self
