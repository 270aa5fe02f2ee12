"""`ltm-lab train fusion`: the constants of depth fusion, fitted to rendered frames."""

from pathlib import Path
from typing import Annotated

import typer

from ltm_core.vision.manifest import DEFAULT_DEPTH_MODEL, DEFAULT_MODEL
from ltm_lab.options import writable_file


def fusion(
    frames: Annotated[
        list[Path],
        typer.Argument(help="Folders of `ltm-lab simulate`; DIR:RASTER: with a raster of what stands or stood."),
    ],
    model: Annotated[str, typer.Option(help="Depth network: manifest name or path.")] = DEFAULT_DEPTH_MODEL,
    segmentation: Annotated[str, typer.Option(help="Network of the labels; default: the shipped one.")] = "",
    out: Annotated[
        Path | None, typer.Option(help="File to write; default: beside the network's manifest.", callback=writable_file)
    ] = None,
    check: Annotated[
        float | None, typer.Option(help="Write nothing; fail if a constant is farther than this from the file's.")
    ] = None,
) -> None:
    """Fit the log odds by which fusion chooses between terrain and network to FRAMES, whose truth is known."""
    from rich.console import Console
    from rich.table import Table

    from ltm_core.depth.expected_surface import FusionSettings
    from ltm_core.depth.fusion_config import FusionConfig, fusion_path, load_fusion_config
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.raster.dem import Dem
    from ltm_core.raster.dem_stack import with_surface
    from ltm_core.tracing import TerrainTracer
    from ltm_core.tracing.possible_ground import NOTHING_BEYOND
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.frames.truth_frames_io import is_curved, open_dem, read_truth_frames, site_frame
    from ltm_lab.training.fusion_fit import constants, fit_fusion, write_fusion_config
    from ltm_lab.training.fusion_samples import FrameSamples, frame_samples

    console = Console()
    manifest, labels = NetworkManifest.find(model), LabelSet.load()
    network, segmenter = DepthNetwork.open(model), Segmenter.open(segmentation or DEFAULT_MODEL)
    settings = FusionSettings()
    # Always from the defaults: a fit that starts from its own result would creep.
    config = FusionConfig()
    folders: list[list[FrameSamples]] = []
    for given in frames:
        name, _, raster = str(given).partition(":")
        folder = Path(name)
        dem, curved = open_dem(folder), is_curved(folder)
        tracer, over = TerrainTracer(dem, curved, possible=NOTHING_BEYOND), None
        if raster:
            tops = with_surface(dem, Dem.open(raster).in_frame(site_frame(folder)))
            over = TerrainTracer(tops, curved, possible=NOTHING_BEYOND)
        found = []
        for frame in read_truth_frames(folder, ""):
            traced = tracer.trace(frame.camera, frame.pose)
            top = None if over is None else over.trace(frame.camera, frame.pose).depth()
            estimate, seen = network.predict(frame.photo, frame.camera), segmenter.segment(frame.photo).labels
            of = traced, estimate, frame.photo, seen, frame.surface, top, labels, settings, config
            samples = frame_samples(*of)
            if samples is not None:
                found.append(samples)
        console.print(f"{given}: {len(found)} frames", markup=False)
        folders.append(found)
    fit = fit_fusion(folders, config)
    path = fusion_path(manifest) if out is None else out
    table = Table("constant", "default", "in the file", "fitted", title=f"fusion with {manifest.name}")
    shipped = {n: v for n, v, _, _ in constants(load_fusion_config(manifest))}
    was = {n: v for n, v, origin, _ in constants(config) if origin == "fitted"}
    off = {}
    for constant, value, origin, _ in constants(fit.config):
        if origin == "fitted":
            table.add_row(constant, f"{was[constant]:g}", f"{shipped[constant]:g}", f"{value:g}")
            off[constant] = abs(value - shipped[constant])
    console.print(table)
    for choice, count in fit.counts.items():
        before, after = fit.loss.get(choice, (float("nan"), float("nan")))
        console.print(f"{choice}: {count:,} pixels; loss on folders left out {before:.4f} -> {after:.4f}")
    if check is not None:
        worst = max(off, key=lambda constant: off[constant])
        console.print(f"farthest from the file: {worst} by {off[worst]:.3g}")
        raise typer.Exit(0 if off[worst] <= check else 1)
    places = " ".join(Path(str(given).partition(":")[0]).name for given in frames)
    source = f"ltm-lab train fusion {places} --model {manifest.name}; labels of {segmenter.manifest.name}"
    write_fusion_config(path, fit.config, source)
    console.print(f"written: {path}", markup=False)
