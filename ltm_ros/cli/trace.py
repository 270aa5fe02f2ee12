"""`ltm trace`: traces one picture to the terrain, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import Overwrite
from ltm_ros.cli.tables import print_table

OUTPUTS = ("range.tif", "depth.tif", "horizontal.tif", "alignment.tif", "seen.tif", "depth.png", "map.png")


def trace(
    dem: Annotated[
        list[Path],
        typer.Option(help="Elevation raster that GDAL reads, projected, in metres; again for coarser ones around it."),
    ],
    pose: Annotated[Path, typer.Option(help="Pose file: pose and calibration (see docs/poses.md).")],
    out: Annotated[Path, typer.Option(help="Folder for the results; made if it is not there.")],
    image: Annotated[Path | None, typer.Option(help="The photo, to draw the depth over.")] = None,
    crs: Annotated[
        str | None, typer.Option(help="CRS of a raster (of several: the finest) that carries none, such as EPSG:32611.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Trace one picture to the terrain: depth and alignment rasters, depth over the photo, a map of the seen cells."""
    import numpy as np
    from rich.console import Console

    from ltm_core.depth.unseen_terrain import MOST_UNKNOWN, unknown_share
    from ltm_core.pictures import to_png
    from ltm_core.pictures.trace import depth_picture, map_picture
    from ltm_core.raster.dem_stack import open_terrain
    from ltm_core.storage.disk_io import require_files
    from ltm_core.tracing import TerrainTracer
    from ltm_core.tracing.trace_io import cell_counts, load_picture_config, read_photo, set_up_picture, write_trace

    console = Console()
    require_files((out / name for name in OUTPUTS), overwrite)
    config = load_picture_config(pose)
    setup = set_up_picture(config, open_terrain([(dem[0], crs), *((path, None) for path in dem[1:])]))
    for doubt in setup.doubts:
        console.print(f"[yellow]{doubt}", highlight=False)
    photo = None if image is None else read_photo(image, setup.camera)
    with console.status("tracing"):
        tracer = TerrainTracer(setup.dem, config.curvature, config.refraction, config.possible_ground)
        traced = tracer.trace(setup.camera, setup.pose)
    with console.status("writing"):
        counts = cell_counts(traced)
        written = write_trace(out, traced, setup.frame, counts)
        title = f"what {image.name if image else pose.stem} sees"
        pictures = {
            "depth.png": depth_picture(traced, setup.dem, photo),
            "map.png": map_picture(traced, setup.dem, counts, title),
        }
        for name, picture in pictures.items():
            written.append(out / name)
            written[-1].write_bytes(to_png(picture))

    ranges = traced.range
    known = ranges[np.isfinite(ranges)]
    cell_area = setup.dem.geometry.resolution**2
    title = f"{setup.camera.width} x {setup.camera.height} pixels over {', '.join(path.name for path in dem)}"
    clearance = tracer.ground_clearance(setup.pose)
    rows = [("camera above the ground", "outside the DEM" if np.isnan(clearance) else f"{clearance:.1f} m")]
    for name, share in (
        ("terrain", np.isfinite(ranges).mean()),
        ("sky", np.isposinf(ranges).mean()),
        ("unknown (outside the DEM, nodata)", np.isnan(ranges).mean()),
    ):
        rows.append((name, f"{share:.1%} of the pixels"))
    if known.size:
        near, median, far = np.percentile(known, [0, 50, 100])
        rows.append(("range: least, median, greatest", f"{near:,.0f} m, {median:,.0f} m, {far:,.0f} m"))
    seen = int((counts > 0).sum())
    rows.append(("DEM cells seen", f"{seen:,} ({seen * cell_area / 1e6:,.2f} km²)"))
    print_table(console, title, ("", ""), rows)
    unknown = unknown_share(ranges)
    if known.size and unknown.whole > MOST_UNKNOWN:
        console.print(f"[yellow]{unknown.reason}.")
    if not known.size:
        x, y = setup.frame.x_origin + setup.pose.position[0], setup.frame.y_origin + setup.pose.position[1]
        covered = setup.dem.geometry.translated(setup.frame.x_origin, setup.frame.y_origin).bounds
        console.print(
            f"[yellow]No pixel sees the terrain. The camera stands at ({x:.0f}, {y:.0f}) in {setup.frame.crs}, where "
            f"the DEM covers x {covered[0]:.0f} to {covered[2]:.0f}, y {covered[1]:.0f} to {covered[3]:.0f}. "
            "Check position, its crs, azimuth and pitch."
        )
    for path in written:
        console.print(f"  {path}", highlight=False)
