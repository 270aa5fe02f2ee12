"""Install a model (`ltm models add`): check and test its files and copy them where models are found by name."""

from __future__ import annotations

import hashlib
import shutil
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

from ltm_core.base.errors import ModelError
from ltm_core.storage.disk_io import is_file
from ltm_core.vision.manifest import RECORDS, NetworkManifest, added_folder, shipped_names

_CHUNK = 1 << 20
_TIMEOUT_S = 60.0


def add_model(
    manifest_path: Path,
    fetch: bool,
    progress: Callable[[int], None] = lambda received: None,
    folder: Path | None = None,
) -> NetworkManifest:
    """Copy a manifest and its files into `folder` (default: the user's own models); return the new manifest.

    The network file is taken where the manifest finds it, or, with `fetch`, from its URL; nothing is downloaded unless
    asked, and the checksum decides what is kept. `progress` gets the bytes received. Raises ModelError: a name that
    ships, a wrong file, or no file and no `fetch`.
    """
    manifest = NetworkManifest.load(manifest_path)
    if manifest.name in shipped_names():
        raise ModelError(
            f"{manifest_path}: a model named {manifest.name!r} ships with the project; choose another name"
        )
    if manifest_path.stem != manifest.name:
        raise ModelError(f"{manifest_path}: its name is {manifest.name!r}; rename the file to {manifest.name}.yaml")
    folder = added_folder() if folder is None else folder
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / manifest.file.name
    part = target.with_name(f"{target.name}.part")
    try:
        _obtain(manifest, part, fetch, progress)
        found = _sha256(part)
        if found != manifest.sha256:
            raise ModelError(
                f"model {manifest.name!r}: the file has sha256 {found}, expected {manifest.sha256}; it was deleted"
            )
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)
    content = manifest_path.read_text(encoding="utf-8")
    # The copy's files lie beside it, whatever folders the original named.
    content = content.replace(str(manifest.file), manifest.file.name)
    if manifest.text is not None:
        shutil.copyfile(manifest.text_file(), folder / manifest.text.file.name)
        content = content.replace(str(manifest.text.file), manifest.text.file.name)
    source = manifest_path.parent
    for beside in (source / manifest.card, *(source / RECORDS).glob("*.yaml")):
        copy = folder / beside.relative_to(source)
        if is_file(beside) and not is_file(copy):
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(beside, copy)
    added = folder / f"{manifest.name}.yaml"
    added.write_text(content, encoding="utf-8")
    return NetworkManifest.load(added)


def _obtain(manifest: NetworkManifest, part: Path, fetch: bool, progress: Callable[[int], None]) -> None:
    try:
        shutil.copyfile(manifest.model_file(), part)
        return
    except ModelError as absent:
        if manifest.url is None:
            raise
        if not fetch:
            raise ModelError(
                f"model {manifest.name!r}: no file {manifest.file}; it is available at {manifest.url}. Add --fetch "
                "to download it"
            ) from absent
    try:
        # The manifest takes https and file URLs only.
        source = urllib.request.urlopen(manifest.url, timeout=_TIMEOUT_S)  # nosec B310
        with source, part.open("wb") as out:
            received = 0
            while chunk := source.read(_CHUNK):
                out.write(chunk)
                received += len(chunk)
                progress(received)
    except (urllib.error.URLError, OSError) as reason:
        raise ModelError(f"model {manifest.name!r}: {manifest.url} cannot be fetched: {reason}") from reason


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()
