"""`ltm export`: the fuel map of a recording, a store or a GeoTIFF, as what fire models and GIS read."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ltm_core.fuel.decision import FuelLayers
    from ltm_core.fuel.prior import FuelPrior
    from ltm_core.grid import GridGeometry
    from ltm_core.site import Site


class Format(StrEnum):
    """What to write."""

    auto = "auto"
    classes = "classes"
    lcp = "lcp"
    landscape = "landscape"
    elmfire = "elmfire"
    layers = "layers"
    png = "png"
    kmz = "kmz"
    ply = "ply"
    las = "las"


class Codes(StrEnum):
    """Surface fuel models."""

    fbfm40 = "fbfm40"
    fbfm13 = "fbfm13"


_BY_SUFFIX = {".tif": Format.classes, ".tiff": Format.classes, ".lcp": Format.lcp, ".png": Format.png}
_BY_SUFFIX |= {".kmz": Format.kmz, ".ply": Format.ply, ".las": Format.las}


def export(
    source: Annotated[
        Path, typer.Argument(help="Store of a site's fuel map (.ltm), bag with a fuel_map topic, or fuel map GeoTIFF.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="File, or folder for elmfire and layers.")],
    site: Annotated[
        Path | None, typer.Option("--site", help="Site file; only a GeoTIFF of classes does without.")
    ] = None,
    crs: Annotated[
        str | None, typer.Option(help="Target CRS; EPSG:5070 gives LANDFIRE's grid. Default: the source's.")
    ] = None,
    format_: Annotated[
        Format,
        typer.Option(
            "--format",
            help="auto: by the suffix of --out. classes: label map; lcp, landscape (GeoTIFF of 8 bands), elmfire "
            "(folder): for fire models; layers: folder of Cloud Optimized GeoTIFFs; png, kmz; ply, las: 3D points.",
        ),
    ] = Format.auto,
    system: Annotated[Codes, typer.Option(help="Fuel models of a landscape.")] = Codes.fbfm40,
) -> None:
    """Write a fuel map; into another CRS by nearest cell, on a grid with edges at 15 mod 30."""
    from ltm_core.errors import ConfigError

    kind = _BY_SUFFIX.get(out.suffix.lower()) if format_ is Format.auto else format_
    if kind is None:
        raise ConfigError(f"{out}: its suffix names no format; give --format, or one of {', '.join(_BY_SUFFIX)}")
    if not out.parent.is_dir():
        raise ConfigError(f"{out}: the folder {out.parent} does not exist; make it first")
    if kind is Format.classes:
        geometry = _export_classes(source, out, site, crs)
    else:
        if site is None:
            raise ConfigError(f"{kind} needs the terrain and the prior fuel map of a site: name its file with --site")
        geometry = _export_site(source, out, site, crs, kind, system)
    typer.echo(f"wrote {out}: {geometry.width} x {geometry.height} cells of {geometry.resolution:g} m, {geometry.crs}")


def _export_classes(source: Path, out: Path, site: Path | None, crs: str | None) -> GridGeometry:
    from ltm_core.errors import ConfigError
    from ltm_core.fuel.fuel_map_io import read_fuel_map, resampled, write_fuel_map
    from ltm_core.site_io import load_site
    from ltm_core.vision.labels import LabelSet

    labels = LabelSet.load()
    if source.suffix.lower() in (".tif", ".tiff"):
        classes, geometry = read_fuel_map(source)
    else:
        if site is None:
            raise ConfigError("a bag's fuel map stands in its site's map frame: name the site file with --site")
        config = load_site(site)
        if source.suffix == ".ltm":
            layers, _, geometry = _site_layers(source, config)
            classes = layers.life_form
        else:
            from ltm_ros.recorded_map import last_fuel_map

            classes, geometry, labels = last_fuel_map(source, config)
    if crs is not None:
        classes, geometry = resampled(classes, geometry, crs)
    write_fuel_map(out, classes, geometry, labels)
    return geometry


def _export_site(source: Path, out: Path, site: Path, crs: str | None, kind: Format, system: Codes) -> GridGeometry:
    """Everything that needs more than the label map."""
    from ltm_core.fuel.codes import FuelSystem, Region
    from ltm_core.fuel.export_grid import GridTransfer, make_landscape, snapped_grid
    from ltm_core.fuel.landscape_io import write_cog, write_elmfire, write_landscape
    from ltm_core.fuel.lcp_io import write_lcp
    from ltm_core.fuel.life_form import NODATA
    from ltm_core.fuel.overlay_io import write_kmz
    from ltm_core.fuel.points_io import fuel_points, write_las, write_ply
    from ltm_core.pictures.fuel import fuel_picture
    from ltm_core.site_io import load_site
    from ltm_core.vision.labels import LabelSet

    config = load_site(site)
    layers, prior, grid = _site_layers(source, config)
    target = grid if crs is None else snapped_grid(grid, crs, config.fuel.phase)
    dem = config.open_dem()
    if kind in (Format.lcp, Format.landscape, Format.elmfire):
        region = Region.named(config.fuel.region)
        chosen = FuelSystem(system.value)
        landscape = make_landscape(layers, prior, dem, config.frame, grid, region, chosen, target)
        if kind is Format.lcp:
            write_lcp(out, landscape, f"{config.name}: fuel map of cameras over {'a prior' if prior else 'no prior'}")
        elif kind is Format.landscape:
            write_landscape(out, landscape)
        else:
            write_elmfire(out, landscape)
        return target
    transfer = GridTransfer(grid, target)
    moved, heights, labels = transfer.layers(layers), transfer.heights(dem, config.frame)[1:-1, 1:-1], LabelSet.load()
    if kind is Format.layers:
        out.mkdir(exist_ok=True)
        nodata = {"prior": NODATA, "code": NODATA, "life_form": 255, "p_max": float("nan"), "entropy": float("nan")}
        for name, layer in vars(moved).items():
            # GeoTIFF has no booleans, and seconds are fine enough for when a cell was seen.
            stored = layer.astype("uint8") if layer.dtype == bool else layer
            stored = (layer // 10**9).astype("uint32") if name == "last_seen" else stored
            write_cog(out / f"{name}.tif", stored, target, nodata.get(name))
    elif kind in (Format.png, Format.kmz):
        picture = fuel_picture(moved, heights, labels, target.resolution)
        if kind is Format.kmz:
            write_kmz(out, picture, target, f"fuel map of {config.name}")
        else:
            from PIL import Image

            Image.fromarray(picture).save(out)
    else:
        points = fuel_points(moved, heights, target, labels)
        (write_ply if kind is Format.ply else write_las)(out, points)
    return target


def _site_layers(source: Path, config: Site) -> tuple[FuelLayers, FuelPrior | None, GridGeometry]:
    """Layers and prior on the fuel grid, in the site's CRS."""
    from ltm_core.errors import RasterError
    from ltm_core.fuel.codes import Region
    from ltm_core.fuel.decision import layers_of_classes
    from ltm_core.fuel.fuel_map_io import read_fuel_map
    from ltm_core.fuel.prior_io import load_prior
    from ltm_core.fuel.site_map import site_evidence_map
    from ltm_core.fuel.stored_map import open_stored_map
    from ltm_core.resources import config_path
    from ltm_core.vision.labels import LabelSet

    if source.suffix == ".ltm":
        geometry = config.fuel_geometry(config.open_dem())
        evidence = site_evidence_map(config, geometry, LabelSet.load(config_path(config.labels)))
        with open_stored_map(source, config, evidence):
            return evidence.layers(), evidence.prior, config.in_crs(geometry)
    if source.suffix.lower() in (".tif", ".tiff"):
        classes, grid = read_fuel_map(source)
        if grid.crs != config.crs:
            raise RasterError(f"{source} is in {grid.crs}, the site in {config.crs}: export the site's own map")
    else:
        from ltm_ros.recorded_map import last_fuel_map

        classes, grid, _ = last_fuel_map(source, config)
    prior = None if config.fuel.prior is None else load_prior(config.fuel.prior, grid)
    return layers_of_classes(classes, prior, Region.named(config.fuel.region)), prior, grid
