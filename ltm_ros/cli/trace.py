"""`ltm trace` and `ltm viewshed`: trace one photo, and map what cameras cover."""

import math
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Option

from ltm_core.base.errors import ConfigError
from ltm_core.storage.disk_io import require_files
from ltm_ros.cli.output import Crs, Dems, OptionalDems, Overwrite, open_dems, print_table, say, warn, working

OUTPUTS = ("range.tif", "depth.tif", "horizontal.tif", "alignment.tif", "seen.tif", "depth.png", "map.png")


def trace(
    dem: Dems,
    pose: Annotated[Path, Option(help="Pose file: pose and calibration (see docs/poses.md).")],
    out: Annotated[Path, Option(help="Folder for the results, created if missing.")],
    image: Annotated[Path | None, Option(help="The photo, to draw the depth over.")] = None,
    crs: Crs = None,
    overwrite: Overwrite = False,
) -> None:
    """Trace a photo to the terrain: depth and alignment rasters, depth over the photo, map of the seen cells."""
    from ltm_core.depth.unseen_terrain import mostly_unknown  # here, because help needs none of them
    from ltm_core.pictures import to_png
    from ltm_core.pictures.trace import depth_picture, map_picture
    from ltm_core.tracing import TerrainTracer
    from ltm_core.tracing.trace_io import cell_counts, load_picture_config, read_photo, set_up_picture, write_trace

    require_files((out / name for name in OUTPUTS), overwrite)
    config = load_picture_config(pose)
    setup = set_up_picture(config, open_dems(dem, crs))
    for doubt in setup.doubts:
        warn(doubt)
    photo = None if image is None else read_photo(image, setup.camera)
    with working("tracing"):
        tracer = TerrainTracer(setup.dem, config.curvature, config.refraction, config.possible_ground)
        traced = tracer.trace(setup.camera, setup.pose)
    with working("writing"):
        counts = cell_counts(traced)
        written = write_trace(out, traced, setup.frame, counts)
        title = f"seen in {image.name if image else pose.stem}"
        written += [out / "depth.png", out / "map.png"]
        written[-2].write_bytes(to_png(depth_picture(traced, setup.dem, photo)))
        written[-1].write_bytes(to_png(map_picture(traced, setup.dem, counts, title, setup.frame)))

    ranges = traced.range
    known = ranges[np.isfinite(ranges)]
    title = f"{setup.camera.width} x {setup.camera.height} pixels over {', '.join(path.name for path in dem)}"
    x, y, z = setup.pose.position
    clearance = float(z - setup.dem.elevation_at(x, y))
    rows = [("camera above the ground", "outside the DEM" if np.isnan(clearance) else f"{clearance:.1f} m")]
    shares = np.isfinite(ranges).mean(), np.isposinf(ranges).mean(), np.isnan(ranges).mean()
    names = "terrain", "sky", "unknown (outside the DEM, nodata)"
    rows += [(name, f"{share:.1%} of the pixels") for name, share in zip(names, shares, strict=True)]
    if known.size:
        near, median, far = np.percentile(known, [0, 50, 100])
        rows.append(("range: minimum, median, maximum", f"{near:,.0f} m, {median:,.0f} m, {far:,.0f} m"))
    seen = int((counts > 0).sum())
    rows.append(("DEM cells seen", f"{seen:,} ({seen * setup.dem.geometry.resolution**2 / 1e6:,.2f} km²)"))
    print_table(title, ("", ""), rows)
    if known.size and (unknown := mostly_unknown(ranges)):
        warn(f"{unknown}.")
    if not known.size:
        x, y = setup.frame.x_origin + x, setup.frame.y_origin + y
        covered = setup.dem.geometry.translated(setup.frame.x_origin, setup.frame.y_origin).bounds
        warn(
            f"No pixel sees the terrain. The camera is at ({x:.0f}, {y:.0f}) in {setup.frame.crs}; the "
            f"DEM covers x {covered[0]:.0f} to {covered[2]:.0f}, y {covered[1]:.0f} to {covered[3]:.0f}. Check "
            "position, its crs, azimuth and pitch."
        )
    for path in written:
        say(f"  {path}")


def viewshed(
    out: Annotated[Path, Option("--out", "-o", help="GeoTIFF: number of cameras, best footprint, visible height.")],
    site: Annotated[Path | None, Option(help="Site file; uses all cameras with calibration and pose.")] = None,
    pose: Annotated[Path | None, Option(help="Pose file of one camera instead of a site; needs --dem.")] = None,
    dem: OptionalDems = None,
    resolution: Annotated[float | None, Option(help="Cell size in metres. Default: the DEM's, or coarser.")] = None,
    target_height: Annotated[float, Option(help="Height of the target above the ground in metres.")] = 0.0,
    max_range: Annotated[float | None, Option(help="Maximum viewing distance in metres.")] = None,
    all_round: Annotated[bool, Option("--all-round", help="Cameras turn: ignore their viewing directions.")] = False,
    picture: Annotated[Path | None, Option(help="PNG to draw. Default: beside the GeoTIFF.")] = None,
    crs: Crs = None,
    overwrite: Overwrite = False,
) -> None:
    """Map what cameras cover: number of cameras, pixel footprint, and height at which smoke becomes visible."""
    from ltm_core.pictures import to_png
    from ltm_core.pictures.trace import coverage_picture, write_coverage
    from ltm_core.visibility.viewshed import viewshed as covered
    from ltm_ros.cli.scene import open_scene

    picture = out.with_suffix(".png") if picture is None else picture
    require_files((out, picture), overwrite)
    if (site is None) == (pose is None):
        raise ConfigError("give --site S.yaml, or --pose P.yaml with --dem")
    scene = open_scene(site, [] if pose is None else [f"{pose.stem}={pose}"], dem, crs)
    views = list(scene.cameras.values())
    if not views:
        raise ConfigError(f"{site}: no camera has both calibration and pose ({', '.join(scene.skipped)}: from topics)")
    if scene.skipped:
        warn(f"skipped, no calibration or pose: {', '.join(scene.skipped)}")
    with working("lines of sight"):
        reach = math.inf if max_range is None else max_range
        coverage = covered(scene.sight, views, resolution, target_height, reach, all_round, scene.ground)
    with working("writing"):
        out.parent.mkdir(parents=True, exist_ok=True)
        picture.parent.mkdir(parents=True, exist_ok=True)
        write_coverage(out, coverage, scene.frame)
        what = "the ground" if target_height == 0 else f"a height of {target_height:g} m above the ground"
        title = f"Number of cameras that see {what}" if len(views) > 1 else f"Where {views[0].name} sees {what}"
        picture.write_bytes(to_png(coverage_picture(coverage, scene.dem, views, title, scene.frame)))

    geometry = coverage.geometry
    rows = [
        (f"seen by {cameras} or more", f"{coverage.share(cameras):.1%} of the ground")
        for cameras in range(1, min(len(views), 4) + 1)
    ]
    seen = np.isfinite(coverage.footprint)
    if seen.any():
        rows.append(("footprint of a pixel, median", f"{np.median(coverage.footprint[seen]):.2f} m"))
    hidden = coverage.height[(coverage.count == 0) & np.isfinite(coverage.height)]
    if hidden.size:
        low, high = np.percentile(hidden, [50, 90])
        rows.append(("hidden ground: visible from", f"{low:.0f} m above it (median), {high:.0f} m (90 %)"))
    title = f"{geometry.width} x {geometry.height} cells of {geometry.resolution:g} m"
    print_table(title, ("", ""), rows)
    for path in (out, picture):
        say(f"  {path}")
