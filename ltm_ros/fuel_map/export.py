"""Write a site's fuel map in a format of fire models, GIS, globes or images, with its provenance."""

from pathlib import Path

from ltm_core.base.resources import config_path
from ltm_core.fuel.class_map import snapped_grid
from ltm_core.fuel.codes import FuelSystem
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.export.companion_files_io import item_path, write_item, write_kmz
from ltm_core.fuel.export.export_grid import GridTransfer
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.export.landscape_io import write_elmfire, write_landscape, write_layers, write_lcp
from ltm_core.fuel.export.provenance import Provenance, landscape_units
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.fuel.prior import system_of
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures import to_png
from ltm_core.pictures.fuel_maps import change_sheet, fuel_sheet, overlay_picture
from ltm_core.pictures.legend import label_legend
from ltm_core.site.site import Site
from ltm_core.vision.labels import LabelSet
from ltm_ros.fuel_map.layers import canvas_of, places_of, seen_window
from ltm_ros.fuel_map.source import FuelSource

LANDSCAPES = ("lcp", "landscape", "elmfire")
PICTURES = ("png", "change")


def sidecars(out: Path, kind: str) -> list[Path]:
    """Return the files beside `out`, except QGIS styles, which are replaced only if they are of `out`."""
    items = [item_path(out)] if kind in ("landscape", "kmz", "lcp") else []
    return [*items, out.with_suffix(".prj")] if kind == "lcp" else items


def export_site(
    map_: FuelSource, out: Path, crs: str | None, kind: str, system: str, as_of: str | None, since: str | None
) -> tuple[GridGeometry, list[str]]:
    """Export everything that needs more than the label map; return the written grid and notes for the user. `kind`: of
    `ltm export --format`. Raises LtmError."""
    if kind in PICTURES:
        _draw(map_, out, kind, as_of, since)
        return map_.geometry, []
    grid = map_.geometry
    target = grid if crs is None else snapped_grid(grid, crs, map_.site.fuel.phase)
    if kind in LANDSCAPES:
        landscape, made, notes = map_.landscape(FuelSystem(system), as_of, target)
        _write(out, kind, landscape, made)
        other = "other " if landscape.terrain_note() else ""
        about = f"{made.line()}\nevery {other}cell with a code has elevation, slope and aspect"
        return target, [about, *(() if map_.prior is None else map_.prior.remarks), *notes]
    layers, terrain = map_.at(as_of), map_.terrain(as_of)
    made = map_.provenance(layers, terrain.version, as_of)
    transfer, palette = GridTransfer(grid, target), life_form_labels(map_.labels)
    moved, heights = transfer.layers(layers), transfer.heights(terrain.ground, map_.site.frame)[1:-1, 1:-1]
    if kind == "layers":
        write_layers(out, moved, target, made.tags(), palette)
        write_item(out, sorted(out.glob("*.tif")), target, made)
    else:
        shown = label_legend(520, palette, set(moved.life_form.ravel().tolist()) - {255})
        picture = overlay_picture(moved, heights, target.resolution, palette)
        write_kmz(out, picture, target, f"fuel map of {map_.site.name}", shown, made)
        write_item(out, [out], target, made)
    return target, [terrain.note] if terrain.note else []


def write_landscapes(evidence: EvidenceMap, site: Site, folder: Path, state: Path) -> list[Path]:
    """Write the map as `landscape.lcp` and `landscape.tif`, for fire models, with their STAC items. `state`: folder of
    its store, and of the confirmed surface if used. Raises ConfigError, RasterError, StoreError."""
    layers, labels = evidence.layers(), LabelSet.load(config_path(site.labels))
    grid, prior = site.in_crs(evidence.geometry), evidence.prior
    source = FuelSource(site, labels, grid, prior, layers, layers, folder=state)
    landscape, made, _ = source.landscape(system_of(prior))
    paths = {folder / "landscape.lcp": "lcp", folder / "landscape.tif": "landscape"}
    for path, kind in paths.items():
        _write(path, kind, landscape, made)
    return list(paths)


def _write(out: Path, kind: str, landscape: Landscape, made: Provenance) -> None:
    """Write a landscape with its STAC item."""
    tags, files = made.tags() | landscape_units(), [out]
    if kind == "lcp":
        write_lcp(out, landscape, made.line())
        files.append(out.with_suffix(".prj"))
    elif kind == "landscape":
        write_landscape(out, landscape, tags)
    else:
        write_elmfire(out, landscape, tags)
        files = sorted(out.glob("*.tif"))
    write_item(out, files, landscape.geometry, made)


def _draw(map_: FuelSource, out: Path, kind: str, as_of: str | None, since: str | None) -> None:
    layers, palette = map_.at(as_of), life_form_labels(map_.labels)
    dem, grid, bounds = map_.site.open_dem(), map_.site.in_map(map_.geometry), None
    places = places_of(map_.site, dem)
    if kind == "change":
        # Show the cells with evidence: on a large prior, changed cells would be dots.
        touched = (map_.layers.last_seen > 0) | map_.layers.changed
        bounds = seen_window(grid, touched, places) if touched.any() else None
    canvas = canvas_of(map_.site, dem, grid, places, bounds)
    heading = map_.provenance(layers, None, as_of).heading(map_.site.crs)
    if kind == "png":
        sheet = fuel_sheet(canvas, layers, palette, heading)
    else:
        names = (since or "prior map", as_of or "now")
        sheet = change_sheet(canvas, map_.empty if since is None else map_.at(since), layers, palette, names, heading)
    out.write_bytes(to_png(sheet))
