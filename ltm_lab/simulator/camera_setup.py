"""Typed configuration of a scenario's cameras: lens and sensor, masts, patrol rounds, errors of their instruments."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ltm_lab.simulator.changes import Strict


class ImagingConfig(Strict):
    samples: int = Field(24, ge=1)  # light paths a pixel
    exposure: float = Field(1.0, gt=0)  # relative to the automatic one
    vignetting: float = Field(0.25, ge=0, le=1)  # part of cos^4 fall-off applied
    noise: float = Field(1.0, ge=0)  # sensor noise relative to a small daylight camera
    jpeg_quality: int = Field(78, ge=1, le=100)  # of the recording's images


class PatrolConfig(Strict):
    """A moving head's round: every azimuth in turn, one frame each `interval_s`; `rounds` times, each `every_s`."""

    azimuth_deg: Annotated[list[float], Field(min_length=1)]
    pitch_deg: list[float] = Field([-6.0])  # one for all azimuths or one each
    rounds: int = Field(1, ge=1)
    interval_s: float = Field(2.0, gt=0)
    every_s: float | None = Field(None, gt=0)  # from the begin of a round to the next one's; none: without a pause
    start_s: float = 0.0

    def begins(self) -> list[float]:
        """Seconds at which the frames of all rounds are taken."""
        stops = len(self.azimuth_deg)
        every = stops * self.interval_s if self.every_s is None else self.every_s
        return [self.start_s + r * every + k * self.interval_s for r in range(self.rounds) for k in range(stops)]

    @model_validator(mode="after")
    def _fits(self) -> "PatrolConfig":
        shortest = (len(self.azimuth_deg) - 1) * self.interval_s
        if self.every_s is not None and self.every_s <= shortest:
            raise ValueError(
                f"a round each {self.every_s:g} s, but its {len(self.azimuth_deg)} frames take {shortest:g} s: "
                "give every_s more, or interval_s less"
            )
        if len(self.pitch_deg) not in (1, len(self.azimuth_deg)):
            raise ValueError(
                f"{len(self.pitch_deg)} pitches for {len(self.azimuth_deg)} azimuths: give one, or one each"
            )
        return self


class SensorConfig(Strict):
    """What a camera's sensors get wrong. A `bias` is the standard deviation of an error that stays over the recording,
    a `sigma` of one that is new with every frame; all zero is a surveyed tower."""

    compass_bias_deg: float = Field(0.0, ge=0)
    compass_sigma_deg: float = Field(0.0, ge=0)
    tilt_sigma_deg: float = Field(0.0, ge=0)  # pitch and roll
    gps_bias: float = Field(0.0, ge=0)  # m
    gps_sigma: float = Field(0.0, ge=0)
    barometer_bias: float = Field(0.0, ge=0)  # m
    barometer_sigma: float = Field(0.0, ge=0)
    clock_offset_s: float = 0.0  # by which its clock is ahead


PHONE = SensorConfig(
    compass_bias_deg=6.0,
    compass_sigma_deg=1.5,
    tilt_sigma_deg=0.7,
    gps_bias=5.0,
    gps_sigma=1.0,
    barometer_bias=4.0,
    barometer_sigma=0.5,
    clock_offset_s=0.25,
)
"""A smartphone held by hand: compass within 5-10 degrees, pitch and roll 0.5-1 degree, GPS 5 m, height 3-10 m."""


Sensor = Literal["tower", "phone"] | SensorConfig
"""`tower` (exact), `phone` (PHONE), or the errors one by one."""


def sensor_config(sensor: Sensor) -> SensorConfig:
    """Return the errors of a sensor."""
    if isinstance(sensor, SensorConfig):
        return sensor
    return PHONE if sensor == "phone" else SensorConfig()


class CameraSetup(Strict):
    """A camera on a mast at map (x, y), `mast` metres above the true ground of the first date."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    x: float
    y: float
    mast: float = Field(15.0, gt=0)
    hfov_deg: float = Field(55.0, gt=0, lt=170)
    sensor: Sensor = "tower"
    patrol: PatrolConfig


class WalkConfig(Strict):
    """A person who walks along `path`, stops at evenly spaced places and takes photos there with a phone in the hand.

    `azimuth_deg`, `pitch_deg`: of the photos in turn, over and over. `portrait`: the same of how the phone is held; a
    portrait has the scenario's image size turned. `hfov_deg` is across the long side. `sway_deg`: standard deviation of
    the hand's pitch and roll about what was meant.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    path: Annotated[list[tuple[float, float]], Field(min_length=2)]
    stops: int = Field(8, ge=2)
    photos: int = Field(3, ge=1)  # at each stop
    interval_s: float = Field(6.0, gt=0)  # between the photos of a stop
    speed: float = Field(1.2, gt=0)  # m/s between stops
    eye: float = Field(1.6, gt=0)  # m above the ground
    hfov_deg: float = Field(69.4, gt=0, lt=170)  # a main camera's 26 mm on 36 mm wide film
    azimuth_deg: Annotated[list[float], Field(min_length=1)]
    pitch_deg: list[float] = Field([-2.0], min_length=1)
    portrait: list[bool] = Field([False, True], min_length=1)
    sway_deg: float = Field(1.5, ge=0)
    geoid_undulation: float = 0.0  # m of the geoid above the ellipsoid there, for altitudes that a phone tells
    sensor: Sensor = "phone"


class ViewsConfig(Strict):
    """Seeded viewpoints: knolls and slopes, with heights, headings and fields of view drawn at random.

    `slopes`: every other eye stands anywhere; without, all stand on knolls, as fire-watch towers do.
    """

    positions: int = Field(8, ge=1)
    views: int = Field(8, ge=1)  # frames a position
    slopes: bool = True
    mast: tuple[float, float] = (2.0, 25.0)
    pitch_deg: tuple[float, float] = (-14.0, 1.0)
    roll_deg: tuple[float, float] = (-3.0, 3.0)
    hfov_deg: tuple[float, float] = (35.0, 68.0)
