"""How a PTZ head is asked where it looks: the section `ptz` of a camera in a site file, one class a kind."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from ltm_core.base.strict_model import StrictModel
from ltm_core.site.source_config import SecretConfig, url_without_secrets

Degrees = Annotated[float, Field(ge=-720, le=720)]


class PatrolConfig(StrictModel):
    """The PTZ head is driven. Nobody else may drive it then: a tour of its own, or an operator, would only fight it."""

    presets: tuple[str, ...] = Field(min_length=1)
    """Names, in their order; from one picture to the next the PTZ head goes to the next one."""
    arrive_within: float = Field(30.0, gt=0, le=60)
    """Seconds, after which it is said to be stuck."""
    settle: float = Field(1.0, ge=0, le=20)
    """Seconds that it must have stood still: after a stop the mast swings, and the lens focuses."""


class PtzSettings(StrictModel):
    """What all kinds have. What is left out of url, user and password is that of the camera's `source`."""

    url: str | None = None
    """`http://HOST` or `https://HOST`, with its port."""
    user: str | None = None
    password: SecretConfig | None = None
    authentication: Literal["auto", "basic", "digest"] = "auto"
    ca: Path | None = None
    check_name: bool = True
    timeout: float = Field(5.0, gt=0, le=60)
    tolerance_deg: float | None = Field(None, gt=0)
    """By which two readings of a PTZ head at rest may differ: their last digit. None: what is usual for the kind."""
    patrol: PatrolConfig | None = None
    """None: the PTZ head is only asked, never driven."""

    @field_validator("url")
    @classmethod
    def _url(cls, url: str | None) -> str | None:
        return None if url is None else url_without_secrets(url, ("http", "https"))

    @model_validator(mode="after")
    def _both(self) -> Self:
        if self.password is not None and self.user is None:
            raise ValueError("password needs user")
        return self


class VapixConfig(PtzSettings):
    """Axis: degrees, and zoom from 1 to 9999."""

    kind: Literal["vapix"]
    camera: int = Field(1, ge=1)
    """Of a device with several."""


class IsapiConfig(PtzSettings):
    """Hikvision and its kin."""

    kind: Literal["isapi"]
    units: Literal["tenths", "degrees"]
    """`tenths`: of a degree, in `status`, which all have; `degrees`: with decimals, in `absoluteEx`, which newer ones
    have. Zoom is ten times the magnification in the first, the magnification in the second."""
    channel: int = Field(1, ge=1)


class OnvifConfig(PtzSettings):
    """ONVIF's generic space runs from -1 to 1 in pan and tilt; what that is in degrees is the model's own."""

    kind: Literal["onvif"]
    path: str = Field("/onvif/device_service", pattern=r"/[!-~]*")
    profile: str | None = None
    """Token of the media profile; None: the first one with a head."""
    pan_range_deg: tuple[Degrees, Degrees] = (-180.0, 180.0)
    """Pan at -1 and at 1."""
    tilt_range_deg: tuple[Degrees, Degrees] = (-90.0, 90.0)

    @model_validator(mode="after")
    def _some_range(self) -> Self:
        for name in ("pan_range_deg", "tilt_range_deg"):
            first, last = getattr(self, name)
            if first == last:
                raise ValueError(f"{name} is from one angle to another, not {first:g} to {last:g}")
        return self


class ReolinkConfig(PtzSettings):
    """Reolink's own counts."""

    kind: Literal["reolink"]
    channel: int = Field(0, ge=0)
    pan_steps_per_deg: float = Field(10.0, gt=0)
    """Counts of `Ppos` a degree; the model's own."""
    tilt_steps_per_deg: float = Field(10.0, gt=0)


PtzConfig = Annotated[VapixConfig | IsapiConfig | OnvifConfig | ReolinkConfig, Field(discriminator="kind")]
