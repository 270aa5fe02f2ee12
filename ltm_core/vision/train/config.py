"""What a training run is made of; YAML overrides these defaults."""

from pathlib import Path

from pydantic import Field, model_validator

from ltm_core.vision.strict import StrictModel


class SplitConfig(StrictModel):
    """Whole scenarios (folders of frames) held out: `validation` picks the weights, `test` gives the scores.

    Without validation scenarios the last weights are kept. All other scenarios train the network. No frame of one
    scene is ever in two parts, so the scores are of unseen ground.
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
    """Widths of the encoder stages (strides 2, 4, 8, 16, 32), their repeats, and of the decoder."""

    widths: tuple[int, int, int, int, int] = (16, 32, 48, 80, 112)
    repeats: tuple[int, int, int, int] = (2, 3, 4, 3)
    expansion: int = Field(default=3, ge=1)
    decoder: int = Field(default=64, ge=8)


class OptimiserConfig(StrictModel):
    steps: int = Field(default=1400, ge=1)
    batch: int = Field(default=8, ge=1)
    small: float = Field(default=0.85, ge=0, le=1)  # share of the steps, the first, at two thirds of the size
    learning_rate: float = Field(default=2.5e-3, gt=0)
    warmup: float = Field(default=0.08, ge=0, lt=1)  # share of the steps
    weight_decay: float = Field(default=0.02, ge=0)
    average: float = Field(default=0.99, ge=0, lt=1)  # decay of the running average of weights that is kept
    class_weight_power: float = Field(default=0.5, ge=0, le=1)  # weight = (1 / share of pixels) ** power
    label_smoothing: float = Field(default=0.02, ge=0, lt=0.5)
    # The simulator labels only the ground of its land cover map; the ranges beyond are 255, but no sky. Weight of
    # that knowledge, below 1 because haze makes the farthest ones look like it.
    unlabelled_not_sky: float = Field(default=0.3, ge=0)
    validate_every: int = Field(default=100, ge=1)


class AugmentConfig(StrictModel):
    """Chance of each change to a training frame; their strengths stand beside their code in `augment`."""

    flip: float = 0.5
    rescale: float = 0.7
    new_sky: float = 0.35
    ground_tint: float = 0.2
    snow: float = 0.08
    haze: float = 0.25
    light: float = 0.65
    grey: float = 0.03
    blur: float = 0.12
    noise: float = 0.35
    jpeg: float = 0.3


class TrainingConfig(StrictModel):
    """One training run: data split, network, optimiser, augmentation, and what the exported model is called."""

    name: str
    frames: Path | None = None  # folder of <scenario>/NNNN.png and NNNN_labels.png; the command line may give it
    seed: int = 0
    width: int = Field(default=512, ge=64, multiple_of=32)
    height: int = Field(default=288, ge=64, multiple_of=32)
    split: SplitConfig
    network: NetworkConfig = NetworkConfig()
    optimiser: OptimiserConfig = OptimiserConfig()
    augment: AugmentConfig = AugmentConfig()
    licence: str = "Apache-2.0"
