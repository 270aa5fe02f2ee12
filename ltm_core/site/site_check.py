"""Check a site file before a run: terrain, cameras, prior fuel map and networks, each with a remedy.

What the graph's nodes would reject one after the other, again at each start, is found here at once, by the code that
they read it with."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ltm_core.base.errors import Findings, ModelError, SiteFinding, SiteVerdict
from ltm_core.base.resources import config_path
from ltm_core.fuel.codes import FuelClimate
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior, load_prior, prior_heights
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import sampled
from ltm_core.raster.heights_check import doubt_of_heights
from ltm_core.site.camera_check import check_angles, check_camera, check_mask
from ltm_core.site.networks import camera_label_errors, label_model, label_network, site_label_errors
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.label_head import find_label_head, read_label_head
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import SHIPPED_LABEL_HEAD, NetworkManifest
from ltm_core.vision.onnx_model import OnnxModel

_FAR_ORIGIN = 30_000.0
"""Distance from the origin in metres beyond which float32 does not resolve millimetres."""


@dataclass
class SiteCheck:
    """Result of a check with the data read for it; None or empty if reading failed."""

    findings: Findings = field(default_factory=Findings)
    site: Site | None = None
    dem: Dem | None = None
    prior: FuelPrior | None = None
    views: list[PosedCamera] = field(default_factory=list)
    """Views of the cameras whose calibration and pose are in the site file."""

    @property
    def wrong(self) -> list[SiteFinding]:
        return [finding for finding in self.findings if finding.verdict is SiteVerdict.WRONG]


def check_site(path: Path, cameras: Sequence[str] = ()) -> SiteCheck:
    """Check all references of a site file. `cameras`: only these; none: all. User errors become findings."""
    check = SiteCheck()
    found = check.findings
    with found.errors("site", path.name):
        site = load_site(path)
        check.site = site
        for name in cameras:
            site.camera(name)
        found.ok("site", path.name, f"{site.name}, {site.crs}")
    if check.site is None or found[0].verdict is not SiteVerdict.OK:
        return check
    with found.errors("terrain", "dem"):
        check.dem = site.open_dem()
        _check_terrain(found, site, check.dem)
        for name in cameras or site.cameras:
            check_camera(found, name, site, check.dem, check.views)
    for name in cameras or site.cameras:
        check_mask(found, site, name)
    check_angles(found, site, cameras)
    _check_fuel(found, site, check)
    _check_networks(found, site)
    return check


def _check_terrain(found: Findings, site: Site, dem: Dem) -> None:
    area, geometry = "terrain", dem.geometry
    known = np.mean([np.isfinite(row).mean() for row in dem.elevation])
    low, high = float(np.nanmin(dem.elevation)), float(np.nanmax(dem.elevation))
    cells = f"{geometry.width} x {geometry.height} cells of {geometry.resolution:g} m"
    found.ok(area, "dem", f"{cells}, heights {low:.0f} to {high:.0f} m, {known:.0%} known")
    for doubt in dem.doubts:
        found.doubt(area, "dem", doubt.text)
    away = geometry.distance_to(0.0, 0.0)
    if away > _FAR_ORIGIN:
        said = f"{away / 1000:.0f} km from the DEM: coordinates lose millimetres; use a corner of the DEM"
        found.doubt(area, "origin", said)
    for level, config in zip(dem.levels[1:], site.coarser, strict=True):
        cells = f"{level.geometry.width} x {level.geometry.height} cells of {level.geometry.resolution:g} m"
        found.ok(area, config.path.name, f"{cells} around it")
    if site.surface is not None:
        with found.errors(area, "surface"):
            surface = site.open_surface(dem)
            for doubt in surface.doubts[len(dem.doubts) :]:
                found.doubt(area, "surface", doubt.text)
            above = float(np.nanmax(sampled(surface, dem.geometry) - sampled(dem, dem.geometry), initial=0.0))
            found.ok(area, "surface", f"up to {above:.0f} m above the ground")


def _check_fuel(found: Findings, site: Site, check: SiteCheck) -> None:
    with found.errors("fuel", "climate and label errors"):
        FuelClimate.named(site.fuel.climate)
        _check_label_errors(found, site)
    dem = check.dem
    if site.fuel.prior is None:
        found.ok("fuel", "prior", "none: cells are unknown until they are seen")
    elif dem is not None:
        grid = site.in_crs(site.fuel_geometry(dem))
        with found.errors("fuel", "prior"):
            check.prior = load_prior(site.fuel.prior, grid)
            heights = prior_heights(site.fuel.prior, grid)
            _check_prior(found, check.prior, grid)
            if heights is not None:
                own = dem.elevation_at(*site.in_map(grid).to_map(*np.mgrid[0 : grid.height, 0 : grid.width]))
                elevations = "the elevations of the prior fuel map"
                doubt = doubt_of_heights(own, heights.astype(np.float64), str(site.dem.path), elevations)
                if doubt is not None:
                    verdict = SiteVerdict.WRONG if doubt.code == "unit" else SiteVerdict.DOUBTFUL
                    found.append(SiteFinding.of("terrain", "dem", doubt.text, verdict))


def _check_label_errors(found: Findings, site: Site) -> None:
    """Check whether the labels that vote were ever measured. Raises ConfigError."""
    network, heads = site_label_errors(site), {}
    with suppress(ModelError):  # `_check_networks` reports a head that cannot be taken
        heads = camera_label_errors(site)
    never = [label_model(site)] if not network.measured and len(heads) < len(site.cameras) else []
    never += sorted({f"label head {site.cameras[name].label_head}" for name, of in heads.items() if not of.measured})
    if not never:
        found.ok("fuel", "label errors", network.state)
        return
    said = (
        f"{', '.join(never)}: unmeasured; these labels change no cell until the fuel map has measured them by its "
        f"first views, or you do: `ltm models measure {label_model(site)} RECORDING --site SITE`"
    )
    found.doubt("fuel", "label errors", said)


def _check_prior(found: Findings, prior: FuelPrior, grid: GridGeometry) -> None:
    share = float((prior.codes != NODATA).mean())
    said = f"{prior.system}, known for {share:.0%} of {grid.width} x {grid.height} cells of {grid.resolution:g} m"
    if prior.contradicting:
        said += f"; in {prior.contradicting} cells its FBFM13 has another fuel type (`own_fbfm13` of the prior)"
    said = "; ".join((said, *prior.remarks))
    found.weighed("fuel", "prior", said, ["check that it covers the site"] if share < 0.5 else [])


def _check_networks(found: Findings, site: Site) -> None:
    area = "networks"
    with found.errors(area, "labels"):
        LabelSet.load(config_path(site.labels))
    for key, name in (("model", site.model), ("depth_model", site.depth_model)):
        if name:
            with found.errors(area, key):
                network = label_network(site, name) if key == "model" else name
                model = OnnxModel(NetworkManifest.find(network).require(depth=key == "depth_model"))
                found.ok(area, key, f"{name}, {model.path.stat().st_size / 1e6:.0f} MB")
                heads_of = model.manifest.heads_of
                if key == "model" and heads_of and site.depth_model == f"{heads_of}_depth":
                    told = f"{site.depth_model} shares an encoder only with label heads: {name}_depth costs less"
                    found.doubt(area, "depth_model", told)
    cameras: dict[str, list[str]] = {}
    for name, camera in site.cameras.items():
        cameras.setdefault(camera.label_head, []).append(name)
    cameras.pop(SHIPPED_LABEL_HEAD, None)
    for head, names in cameras.items():
        with found.errors(area, f"label head {head}"):
            manifest = NetworkManifest.find(site.model).serving(head)
            file = find_label_head(head, manifest, site.label_heads)
            one_view = file is not None and read_label_head(file, manifest)[1].one_view
            doubts = ["it was trained on one view and is for that only; train one for each"]
            found.weighed(
                area, f"label head {head}", f"of {', '.join(names)}: {file}", doubts if one_view and names[1:] else []
            )
