"""`ltm-lab train appearance`: fits what a fuel cell of each life form looks like to a network, for the fuel map."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_lab.options import writable_folder


def appearance(
    frames: Annotated[list[Path], Argument(help="Folders of `ltm-lab simulate`: two sites or more, of one date.")],
    model: Annotated[str, Option(help="The network: name or manifest.")] = DEFAULT_MODEL,
    out: Annotated[
        Path | None,
        Option("--out", "-o", help="Folder of models. Default: config/models.", callback=writable_folder),
    ] = None,
    threads: Annotated[int, Option(help="CPU threads of the network.")] = 1,
) -> None:
    """Learn from FRAMES what cells of known life form look like to a network, and how much its errors hang together."""
    from rich.console import Console

    from ltm_core.fuel.label_errors import ReliabilityRecord, find_record, labels_digest, write_record
    from ltm_core.fuel.life_form import LifeForm
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.manifest import models_folder
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.fuel.cell_appearance_io import learn_cell_appearance
    from ltm_lab.evaluation.fuel.simulated_votes import simulated_votes

    console = Console()
    segmenter, labels = Segmenter.open(model, threads=threads), LabelSet.load()
    name = segmenter.manifest.name
    with console.status("") as status:
        sites = []
        for folder in frames:
            status.update(f"{folder}: labels and votes")
            sites.append(simulated_votes(folder, segmenter, labels))
        status.update("learning")
        learnt = learn_cell_appearance(sites, labels)
    count = sum(len(site.votes) for site in sites)
    places = ", ".join(site.scenario for site in sites)
    source = f"cells by ltm-lab train appearance on {count} frames of {places}"
    manifest = segmenter.manifest
    record = find_record(manifest) or ReliabilityRecord(
        source=source, network=name, labels=labels_digest(manifest), photos=0
    )
    about = source if record.source == source else f"{record.source.split('; cells')[0]}; {source}"
    learnt_now = {"source": about, "correlation": learnt.correlation, "appearance": learnt.appearance.rounded()}
    file = write_record(record.model_copy(update=learnt_now), out or models_folder())
    for form, right, voted in learnt.right:
        console.print(
            f"cells of {LifeForm(form).name.lower()} on a site that taught nothing: told rightly {right:.0%}, "
            f"by most of their labels {voted:.0%}",
            highlight=False,
        )
    text = ", ".join(f"{key}: {value:.2f}" for key, value in learnt.correlation.model_dump().items())
    console.print(f"correlation of what is wrong: {{{text}}}\n{file}", highlight=False)
