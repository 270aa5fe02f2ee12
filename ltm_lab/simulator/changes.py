"""Typed changes of a site between its dates (fire, felling, growth, landslide, ...), each with a mask and a time."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Point = tuple[float, float]
Cover = Literal["conifer", "oak", "shrub", "grass", "bare"]


class Strict(BaseModel):
    """A mapping whose unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class MaskConfig(Strict):
    """Where a change applies, in map metres: one of `polygon`, `circle` (x, y, radius), `box` (x_min, y_min, x_max,
    y_max).

    `ragged`: how far the edge wanders from the drawn line (m).
    """

    polygon: Annotated[list[Point], Field(min_length=3)] | None = None
    circle: tuple[float, float, Annotated[float, Field(gt=0)]] | None = None
    box: tuple[float, float, float, float] | None = None
    ragged: float = Field(10.0, ge=0)

    @model_validator(mode="after")
    def _one_shape(self) -> "MaskConfig":
        given = [n for n in ("polygon", "circle", "box") if getattr(self, n) is not None]
        if len(given) != 1:
            raise ValueError(f"give one of polygon, circle, box; got {' and '.join(given) or 'none'}")
        if self.box is not None and not (self.box[0] < self.box[2] and self.box[1] < self.box[3]):
            raise ValueError(f"box {self.box} must be (x_min, y_min, x_max, y_max) with minima below maxima")
        return self

    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) of the drawn line."""
        if self.box is not None:
            return self.box
        if self.circle is not None:
            x, y, r = self.circle
            return x - r, y - r, x + r, y + r
        assert self.polygon is not None  # nosec B101 # tells the type checker what holds
        xs, ys = zip(*self.polygon, strict=True)
        return min(xs), min(ys), max(xs), max(ys)


class _Change(Strict):
    """`years`: when it happens, after the scenario's start; dates before it do not see it."""

    years: float = 0.0
    mask: MaskConfig


class Burn(_Change):
    """A fire of `severity` 0 (light underburn) to 1 (stand-replacing).

    Ground is charred at first, herbs follow within the year, shrubs resprout from the third.
    """

    kind: Literal["burn"]
    severity: float = Field(0.8, gt=0, le=1)


class Conversion(_Change):
    """Cover of the classes `of` becomes `to`, `age` years old when it stands there at once."""

    kind: Literal["conversion"]
    to: Cover
    of: list[Literal["grass", "shrub", "tree", "bare"]] = ["grass", "shrub"]
    age: float = Field(40.0, ge=0)


class Thinning(_Change):
    """All but the share `keep` of the plants of the classes `of` are felled and taken away."""

    kind: Literal["thinning"]
    keep: float = Field(0.4, ge=0, le=1)
    of: list[Literal["shrub", "tree"]] = ["tree"]


class Landslide(_Change):
    """The upper half of the mask slides by up to `depth` metres into the lower half, which keeps the share `deposit`
    of it."""

    kind: Literal["landslide"]
    depth: float = Field(6.0, gt=0)
    deposit: float = Field(0.8, ge=0, le=1)


class Cut(_Change):
    """The ground in the mask is lowered by `depth` metres (negative: filled), with sides `ramp` metres wide."""

    kind: Literal["cut"]
    depth: float
    ramp: float = Field(8.0, gt=0)


Change = Annotated[Burn | Conversion | Thinning | Landslide | Cut, Field(discriminator="kind")]
