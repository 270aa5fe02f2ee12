"""Typed configuration of a simulated recording: the SCENARIO.yaml of `ltm-lab simulate`."""

from typing import Annotated

from pydantic import Field, field_validator, model_validator
from pyproj import CRS
from pyproj.exceptions import CRSError

from ltm_core.geometry.camera import Camera
from ltm_lab.simulator.camera_setup import CameraSetup, ImagingConfig, ViewsConfig, WalkConfig
from ltm_lab.simulator.changes import Change, Strict

LAST_NS = 2**31 * 10**9 - 1
"""The last nanosecond that the stamp of a recorded frame holds, whose seconds are int32."""
_YEAR_NS = 365.2425 * 86_400 * 1e9


class GroundConfig(Strict):
    """The ground that is made. Lengths in metres; the site is the square [0, size]^2 of the map frame."""

    size: float = Field(4000.0, gt=0)
    resolution: float = Field(4.0, gt=0)
    surroundings: float = Field(8192.0, gt=0)  # side of the evolved range around the site, same centre
    relief: float = Field(620.0, gt=0)
    base_elevation: float = 340.0
    erodibility: float = Field(2.0e-6, gt=0)
    diffusivity: float = Field(0.0008, ge=0)  # m^2/a: larger rounds ridges off
    repose: float = Field(0.95, gt=0)  # tangent of the steepest stable slope
    roughness: float = Field(1.0, ge=0)  # m, relief below the evolution's scale


class LakeConfig(Strict):
    """A reservoir about map (x, y): water `depth` metres over the ground there, dammed at `radius`."""

    x: float
    y: float
    depth: float = Field(12.0, gt=0)
    radius: float = Field(160.0, gt=20)


class VegetationConfig(Strict):
    """Cover of the land: the share of the site that each class gets; the rest is shrub."""

    houses: int = Field(0, ge=0, le=500)

    tree: float = Field(0.2, ge=0, le=1)
    grass: float = Field(0.22, ge=0, le=1)
    bare: float = Field(0.07, ge=0, le=1)
    scrub: float = Field(0.5, ge=0, le=1)  # low coastal scrub against tall chaparral; half: dry slopes have scrub
    conifers: float = Field(0.5, ge=0, le=1)  # conifers against oaks; half: high, shaded ground has conifers
    road: bool = True
    patch: float = Field(260.0, gt=0)  # m, the longest wavelength of patches
    green: float = Field(0.25, ge=0, le=1)  # 0: cured, 1: a wet spring
    age: float = Field(25.0, gt=0)  # years of the shrubs at the start; trees are 35 years older
    growing: bool = True  # plants age with the dates
    density: float = Field(1.0, ge=0, le=3)  # of shrubs and trees, relative to closed cover
    detail_radius: float = Field(1300.0, gt=0)  # m round a camera within which every shrub has its own shape
    grass_radius: float = Field(220.0, ge=0)  # m round a camera within which grass stands as blades

    @model_validator(mode="after")
    def _shares(self) -> "VegetationConfig":
        if self.tree + self.grass + self.bare > 1:
            raise ValueError(f"tree + grass + bare is {self.tree + self.grass + self.bare:.2f}, must be at most 1")
        return self


class SunConfig(Strict):
    azimuth_deg: float = 215.0
    elevation_deg: float = Field(38.0, gt=2, le=90)
    turbidity: float = Field(3.5, ge=1, le=10)


class AtmosphereConfig(Strict):
    """Haze: radiance L at distance d is seen as L exp(-d / visibility) + airlight (1 - exp(-d / visibility))."""

    visibility: float = Field(11000.0, gt=0)  # m, 1/e length in green
    blue: float = 0.35  # how much faster blue fades than red: exponents 1 - blue/2 (red) .. 1 + blue/2 (blue)


class SmokeConfig(Strict):
    """A column of smoke from map (x, y): `height` and `drift` are its last puff's, metres; `wind_deg` is where the
    wind blows to, clockwise from grid north."""

    x: float
    y: float
    height: float = Field(220.0, gt=0)
    drift: float = Field(260.0, ge=0)
    width: float = Field(9.0, gt=0)  # m at the foot
    wind_deg: float = 90.0
    thickness: float = Field(0.5, gt=0, le=1)  # opacity of a puff's middle
    puffs: int = Field(260, ge=1)


class OutdatedDemConfig(Strict):
    """The DEM handed to the system: an older, coarser, shifted copy of the first date's true ground."""

    resolution: float = Field(5.0, gt=0)
    sigma: float = Field(0.7, ge=0)  # m, standard deviation of its smooth error
    shift: tuple[float, float] = (0.0, 0.0)  # m by which its content lies too far east, north
    bias: float = 0.0  # m by which it is too high


class DateConfig(Strict):
    """One visit to the site, `years` after the scenario's start."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    years: float = Field(0.0, ge=0)
    frames: bool = True  # false: only its rasters are wanted


class ImageSize(Strict):
    width: int = Field(1920, ge=8)
    height: int = Field(1080, ge=8)


class Scenario(Strict):
    """One simulated recording. Unknown keys are refused; defaults stand here and nowhere else."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    seed: int = Field(ge=0)
    crs: str = "EPSG:32611"
    origin: tuple[float, float] = (380000.0, 3806000.0)  # map (0, 0) in the CRS
    start_ns: int = 1_750_000_000_000_000_000
    truth_step: int = Field(4, ge=1)
    curvature: bool = True  # earth curvature with refraction 0.13, as the tracer assumes
    image: ImageSize = ImageSize()
    terrain: GroundConfig = GroundConfig()
    vegetation: VegetationConfig = VegetationConfig()
    sun: SunConfig = SunConfig()
    atmosphere: AtmosphereConfig = AtmosphereConfig()
    imaging: ImagingConfig = ImagingConfig()
    smoke: list[SmokeConfig] = Field([])
    lakes: list[LakeConfig] = Field([])
    dem: OutdatedDemConfig = OutdatedDemConfig()
    dem_around: OutdatedDemConfig = OutdatedDemConfig(resolution=10.0, sigma=1.0)  # of the range about the site
    dates: list[DateConfig] = Field([DateConfig(name="now")], min_length=1)
    changes: list[Change] = Field([])
    cameras: list[CameraSetup] = Field([])
    walks: list[WalkConfig] = Field([])
    views: ViewsConfig | None = None

    @field_validator("crs")
    @classmethod
    def _in_metres(cls, name: str) -> str:
        try:
            crs = CRS.from_user_input(name)
        except CRSError as e:
            raise ValueError(f"{name!r} is no CRS that PROJ knows; give one such as EPSG:32611") from e
        if not crs.is_projected or any(axis.unit_name != "metre" for axis in crs.axis_info):
            raise ValueError(f"{name} is {crs.name}, which is not in metres; give a projected CRS such as EPSG:32611")
        return name

    @model_validator(mode="after")
    def _something_to_see(self) -> "Scenario":
        if not self.cameras and not self.walks and self.views is None:
            raise ValueError("no camera: give `cameras`, `walks` or `views`")
        cameras = [c.name for c in self.cameras] + [w.name for w in self.walks]
        for of, names in (("cameras", cameras), ("dates", [d.name for d in self.dates])):
            if len(set(names)) != len(names):
                raise ValueError(f"names of {of} must differ, got {names}")
        if sorted(d.years for d in self.dates) != [d.years for d in self.dates]:
            raise ValueError(f"dates must be in order of years, got {[d.years for d in self.dates]}")
        for i, date in enumerate(self.dates):
            if self.start_of(date) > LAST_NS:
                raise ValueError(
                    f"dates.{i} ({date.name}): {date.years:g} years after start_ns {self.start_ns} is past 19 January "
                    f"2038, the last day that a stamp can hold; give a start_ns of {LAST_NS - self._after(date)} or "
                    "less"
                )
        self._all_inside_the_site()
        for i, change in enumerate(self.changes):
            if change.years > self.dates[-1].years:
                raise ValueError(
                    f"changes.{i} ({change.kind}): it happens in year {change.years:g}, after the last date "
                    f"({self.dates[-1].name}, year {self.dates[-1].years:g}); give a date that sees it"
                )
        return self

    def _all_inside_the_site(self) -> None:
        """Raises ValueError that names what lies outside, and what would be right."""
        size, within = self.terrain.size, f"[0, {self.terrain.size:g}]^2"
        if self.terrain.surroundings < size:
            raise ValueError(
                f"terrain.surroundings is {self.terrain.surroundings:g} m, narrower than the site of {size:g} m; give "
                f"at least {size:g}"
            )
        for i, change in enumerate(self.changes):
            x_min, y_min, x_max, y_max = change.mask.bounds()
            if x_min < 0 or y_min < 0 or x_max > size or y_max > size:
                raise ValueError(
                    f"changes.{i} ({change.kind}): its mask reaches x {x_min:g} .. {x_max:g}, "
                    f"y {y_min:g} .. {y_max:g}, outside the site {within}; draw it inside"
                )
        points = [(f"cameras.{i}: {c.name}", c.x, c.y) for i, c in enumerate(self.cameras)]
        points += [(f"walks.{i}: {w.name}'s path", x, y) for i, w in enumerate(self.walks) for x, y in w.path]
        points += [(f"smoke.{i}: the column", column.x, column.y) for i, column in enumerate(self.smoke)]
        for what, x, y in points:
            if not (0 < x < size and 0 < y < size):
                raise ValueError(f"{what} at ({x:g}, {y:g}) is outside the site {within}; place it inside")

    def start_of(self, date: DateConfig) -> int:
        """When the visit of `date` begins, nanoseconds since the epoch."""
        return self.start_ns + self._after(date)

    @staticmethod
    def _after(date: DateConfig) -> int:
        return round(date.years * _YEAR_NS)

    def camera_model(self, hfov_deg: float, portrait: bool = False) -> Camera:
        """Return the camera of this scenario's image size with a field of view of `hfov_deg`; `portrait`: the same
        turned by a quarter."""
        width, height = self.image.width, self.image.height
        camera = Camera.from_fov(width, height, hfov_deg)
        return Camera(height, width, camera.fx, camera.fy, camera.cy, camera.cx) if portrait else camera
