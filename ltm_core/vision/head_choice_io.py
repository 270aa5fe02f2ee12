"""Finds the heads that `label_head: auto` chooses among."""

from __future__ import annotations

from pathlib import Path

from ltm_core.base.errors import ModelError
from ltm_core.vision.head_choice import HeadChoice
from ltm_core.vision.label_head import LabelHead, places_of_label_heads, read_label_head
from ltm_core.vision.manifest import AUTO_HEAD, NetworkManifest
from ltm_core.vision.picture_domain import DomainSpace
from ltm_core.vision.picture_domain_io import domain_path, load_domain


def open_choice(manifest: NetworkManifest, folder: Path | None = None) -> HeadChoice:
    """The choice among all heads of a network that can be chosen. `folder`: a site's heads. Raises as
    `heads_to_choose`."""
    return HeadChoice(_space(manifest), list(heads_to_choose(manifest, folder)[0].values()))


def heads_to_choose(
    manifest: NetworkManifest, folder: Path | None = None
) -> tuple[dict[Path, LabelHead], dict[Path, str]]:
    """The files of all heads of a network that say where their photos lie, in order of name, and the files that are
    passed over, with the reason. Of two files of one name that in `folder`, a site's, is taken, as by
    `find_label_head`.

    Raises ModelError for a network of which nobody measured where pictures lie.
    """
    space, named = _space(manifest), dict[str, Path]()
    for place in places_of_label_heads(manifest, folder):
        for path in sorted(place.glob("*.yaml")):
            named.setdefault(path.stem, path)
    taken, passed = dict[Path, LabelHead](), dict[Path, str]()
    for _, path in sorted(named.items()):
        try:
            head, content = read_label_head(path, manifest)
        except ModelError as reason:
            passed[path] = str(reason)
            continue
        if content.by_name:
            continue  # as it was meant, so there is nothing to tell
        if content.one_view:
            passed[path] = "is for one view alone: name it at the camera that has that view"
        elif head.domain is None or head.domain.axes != space.checksum:
            passed[path] = "does not say where its photos lie among the network's; teach it again: ltm train head"
        else:
            taken[path] = head
    return taken, passed


def _space(manifest: NetworkManifest) -> DomainSpace:
    space = load_domain(manifest)
    if space is None:
        raise ModelError(
            f"head {AUTO_HEAD!r}: nobody measured where pictures of network {manifest.name!r} lie, there is no "
            f"{domain_path(manifest)}; measure it (ltm-lab train domains), or name a head"
        )
    return space
