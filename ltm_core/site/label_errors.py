"""What is known of the errors of a site's networks, from the site file. Apart from the map that weighs votes by it, so
that who checks a site loads no map."""

from __future__ import annotations

from pathlib import Path

from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.site.site import Site
from ltm_core.vision.head_choice_io import heads_to_choose
from ltm_core.vision.manifest import AUTO_HEAD, SHIPPED_HEAD, Manifest


def site_label_errors(site: Site) -> LabelErrors:
    """What is known of the errors of the site's network. Raises ConfigError."""
    given = site.fuel.label_errors
    return LabelErrors.of_model(site.model) if given is None else LabelErrors.load(Path(given))


def camera_label_errors(site: Site) -> dict[str, LabelErrors]:
    """Those of the cameras whose network has a head of its own: a head errs otherwise than what it corrects.

    Which of several a camera's pictures have chosen is not known of its votes: they err as all of them do in the mean.
    Empty where the site file states its errors. Raises ConfigError; ModelError for a head that cannot be taken.
    """
    if site.fuel.label_errors is not None:
        return {}
    known: dict[str, LabelErrors] = {}
    for head in {camera.head for camera in site.cameras.values()} - {SHIPPED_HEAD}:
        if head != AUTO_HEAD:
            known[head] = LabelErrors.of_head(site.model, head, site.heads)
            continue
        network = Manifest.find(site.model)
        if files := list(heads_to_choose(network.serving(head), site.heads)[0]):
            every = [LabelErrors.of_head(site.model, str(file.absolute())) for file in files]
            known[head] = LabelErrors.mean([LabelErrors.of_model(network.heads_of or site.model), *every])
    return {name: known[camera.head] for name, camera in site.cameras.items() if camera.head in known}
