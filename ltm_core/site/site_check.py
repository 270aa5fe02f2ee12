"""Check a site file before a run: terrain, cameras, prior fuel map and networks, each with a remedy.

What the graph's nodes would reject one after the other, again at each start, is found here at once, by the code that
they read it with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ltm_core.base.errors import LtmError, ModelError, SiteFinding, SiteVerdict
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

    findings: list[SiteFinding] = field(default_factory=list)
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
    try:
        check.site = site = load_site(path)
        for name in cameras:
            site.camera(name)
    except LtmError as error:
        check.findings.append(SiteFinding.of("site", path.name, error))
        return check
    check.findings.append(SiteFinding("site", path.name, SiteVerdict.OK, f"{site.name}, {site.crs}"))
    try:
        check.dem = site.open_dem()
    except LtmError as error:
        check.findings.append(SiteFinding.of("terrain", "dem", error))
    else:
        check.findings += _terrain(site, check.dem)
        for name in cameras or site.cameras:
            check.findings += check_camera(name, site, check.dem, check.views)
    for name in cameras or site.cameras:
        check.findings += check_mask(site, name)
    check.findings += check_angles(site, cameras)
    check.findings += _fuel(site, check)
    check.findings += _networks(site)
    return check


def _terrain(site: Site, dem: Dem) -> Iterator[SiteFinding]:
    area, geometry = "terrain", dem.geometry
    known = [np.isfinite(row).mean() for row in dem.elevation]
    low, high = float(np.nanmin(dem.elevation)), float(np.nanmax(dem.elevation))
    found = (
        f"{geometry.width} x {geometry.height} cells of {geometry.resolution:g} m, heights {low:.0f} to {high:.0f} m, "
        f"{np.mean(known):.0%} known"
    )
    yield SiteFinding(area, "dem", SiteVerdict.OK, found)
    for doubt in dem.doubts:
        yield SiteFinding.of(area, "dem", doubt.text, SiteVerdict.DOUBTFUL)
    away = geometry.distance_to(0.0, 0.0)
    if away > _FAR_ORIGIN:
        said = f"{away / 1000:.0f} km from the DEM: coordinates lose millimetres; use a corner of the DEM"
        yield SiteFinding(area, "origin", SiteVerdict.DOUBTFUL, said)
    for level, config in zip(dem.levels[1:], site.coarser, strict=True):
        found = f"{level.geometry.width} x {level.geometry.height} cells of {level.geometry.resolution:g} m around it"
        yield SiteFinding(area, config.path.name, SiteVerdict.OK, found)
    if site.surface is not None:
        yield from _surface(site, dem)


def _surface(site: Site, dem: Dem) -> Iterator[SiteFinding]:
    assert site.surface is not None  # nosec B101 # tells the type checker what holds
    try:
        surface = site.open_surface(dem)
    except LtmError as error:
        yield SiteFinding.of("terrain", "surface", error)
        return
    for doubt in surface.doubts[len(dem.doubts) :]:
        yield SiteFinding.of("terrain", "surface", doubt.text, SiteVerdict.DOUBTFUL)
    above = float(np.nanmax(sampled(surface, dem.geometry) - sampled(dem, dem.geometry), initial=0.0))
    yield SiteFinding("terrain", "surface", SiteVerdict.OK, f"up to {above:.0f} m above the ground")


def _fuel(site: Site, check: SiteCheck) -> Iterator[SiteFinding]:
    area = "fuel"
    try:
        FuelClimate.named(site.fuel.climate)
        yield _reliability(site)
    except LtmError as error:
        yield SiteFinding.of(area, "climate and label errors", error)
    yield from _growth(site, check)
    if site.fuel.prior is None:
        yield SiteFinding(area, "prior", SiteVerdict.OK, "none: cells are unknown until they are seen")
    elif check.dem is not None:
        grid = site.in_crs(site.fuel_geometry(check.dem))
        try:
            check.prior = load_prior(site.fuel.prior, grid)
            heights = prior_heights(site.fuel.prior, grid)
        except LtmError as error:
            yield SiteFinding.of(area, "prior", error)
            return
        yield _prior(check.prior, grid)
        if heights is not None:
            own = check.dem.elevation_at(*site.in_map(grid).to_map(*np.mgrid[0 : grid.height, 0 : grid.width]))
            elevations = "the elevations of the prior fuel map"
            doubt = doubt_of_heights(own, heights.astype(np.float64), str(site.dem.path), elevations)
            if doubt is not None:
                verdict = SiteVerdict.WRONG if doubt.code == "unit" else SiteVerdict.DOUBTFUL
                yield SiteFinding.of("terrain", "dem", doubt.text, verdict)


def _reliability(site: Site) -> SiteFinding:
    """Check whether the labels that vote were ever measured. Raises ConfigError."""
    network, heads = site_label_errors(site), {}
    with suppress(ModelError):  # `_heads` reports a head that cannot be taken
        heads = camera_label_errors(site)
    never = [label_model(site)] if not network.measured and len(heads) < len(site.cameras) else []
    never += sorted({f"label head {site.cameras[name].label_head}" for name, of in heads.items() if not of.measured})
    if not never:
        return SiteFinding("fuel", "label errors", SiteVerdict.OK, network.state)
    found = (
        f"{', '.join(never)}: unmeasured; these labels change no cell until the fuel map has measured them by its "
        f"first views, or you do: `ltm models measure {label_model(site)} RECORDING --site SITE`"
    )
    return SiteFinding("fuel", "label errors", SiteVerdict.DOUBTFUL, found)


def _growth(site: Site, check: SiteCheck) -> Iterator[SiteFinding]:
    """Check the tree line: in feet, or of another place, it would withdraw no tree of the site or all of them."""
    line = site.fuel.growth.tree_line_m
    if line is None or check.dem is None:
        return
    rows = check.dem.elevation  # one by one: no mask of a whole raster
    above = float(sum((row > line).sum() for row in rows) / sum(np.isfinite(row).sum() for row in rows))
    found = f"{above:.0%} of the terrain lies above {line:g} m: no tree there votes"
    yield SiteFinding("fuel", "tree line", SiteVerdict.OK, found)


def _prior(prior: FuelPrior, grid: GridGeometry) -> SiteFinding:
    share = float((prior.codes != NODATA).mean())
    found = f"{prior.system}, known for {share:.0%} of {grid.width} x {grid.height} cells of {grid.resolution:g} m"
    if prior.contradicting:
        found += f"; in {prior.contradicting} cells its FBFM13 has another fuel type (`own_fbfm13` of the prior)"
    found = "; ".join((found, *prior.remarks))
    if share < 0.5:
        return SiteFinding("fuel", "prior", SiteVerdict.DOUBTFUL, f"{found}: check that it covers the site")
    return SiteFinding("fuel", "prior", SiteVerdict.OK, found)


def _networks(site: Site) -> Iterator[SiteFinding]:
    try:
        LabelSet.load(config_path(site.labels))
    except LtmError as error:
        yield SiteFinding.of("networks", "labels", error)
    for key, name in (("model", site.model), ("depth_model", site.depth_model)):
        if not name:
            continue
        try:
            network = label_network(site, name) if key == "model" else name
            model = OnnxModel(NetworkManifest.find(network).require(depth=key == "depth_model"))
        except LtmError as error:
            yield SiteFinding.of("networks", key, error)
        else:
            yield SiteFinding("networks", key, SiteVerdict.OK, f"{name}, {model.path.stat().st_size / 1e6:.0f} MB")
            if key == "model" and model.manifest.heads_of and site.depth_model == f"{model.manifest.heads_of}_depth":
                told = f"{site.depth_model} shares an encoder only with label heads: {name}_depth costs less"
                yield SiteFinding("networks", "depth_model", SiteVerdict.DOUBTFUL, told)
    yield from _heads(site)


def _heads(site: Site) -> Iterator[SiteFinding]:
    cameras: dict[str, list[str]] = {}
    for name, camera in site.cameras.items():
        cameras.setdefault(camera.label_head, []).append(name)
    for head, names in cameras.items():
        if head == SHIPPED_LABEL_HEAD:
            continue
        doubt = ""
        try:
            manifest = NetworkManifest.find(site.model).serving(head)
            file = find_label_head(head, manifest, site.label_heads)
            if file is not None:
                content = read_label_head(file, manifest)[1]
                if content.one_view and len(names) > 1:
                    doubt = "it was trained on one view and is for that only; train one for each"
        except LtmError as error:
            yield SiteFinding.of("networks", f"label head {head}", error)
        else:
            said = f"of {', '.join(names)}: {file}"
            verdict = SiteVerdict.DOUBTFUL if doubt else SiteVerdict.OK
            yield SiteFinding("networks", f"label head {head}", verdict, f"{said}; {doubt}" if doubt else said)
