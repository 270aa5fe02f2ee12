"""What README and docs tell a reader to type exists: commands, options, `make` targets, files, links, site keys. The
Python example of the README is run. Nothing heavy is: commands are held against the command line's own description.
"""

import importlib
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from ltm_core.base.resources import project_path
from ltm_core.base.strict_model import with_expert
from ltm_core.site.site import Site
from ltm_core.tracing.trace_io import PictureConfig
from ltm_core.uplink.config import RegionConfig
from ltm_lab.cli import eval as eval_commands
from ltm_lab.cli import train as train_commands
from ltm_lab.cli.main import cli as lab_cli
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import compressed_to_rgb, encode_rgb
from ltm_ros.cli.main import cli
from ltm_ros.site_setup.sources import load_sources

REPOSITORY = Path(__file__).parents[2]
PAGES = sorted(
    [*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md"), *(REPOSITORY / "config/models").glob("*.md")]
)
HISTORY = REPOSITORY / "CHANGELOG.md"
"""Names what was, too, so that only its links are checked."""
TODAYS = [page for page in PAGES if page != HISTORY]

PROGRAMS = ("ltm ", "ltm-lab ")
DEFAULTS = {"eval": eval_commands.WHOLE, "train": train_commands.WHOLE}
"""What a group of commands runs where its first argument is none of them."""
FOREIGN = {
    "--no-deps",
    "--target",
    "--packages-select",
    "--break-system-packages",
    "--system-site-packages",
    "--strict",
}
"""Options of pip, colcon, venv and MkDocs that the pages name by themselves."""
ROOTS = (
    "ltm_core",
    "ltm_msgs_py",
    "ltm_ros",
    "ltm_lab",
    "config",
    "bags",
    "docs",
    "tests",
    "examples",
    "scripts",
    ".ci",
)

_FENCE = re.compile(r"^( *)```([^\n]*)\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`([^`\n]+)`")
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)(?: \"[^\"]*\")?\)")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    language: str
    text: str


def blocks(page: Path, *languages: str) -> list[Block]:
    found = _FENCE.findall(page.read_text(encoding="utf-8"))
    return [Block(page, language, text) for _, language, text in found if language in languages]


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return _FENCE.sub("", page.read_text(encoding="utf-8"))


def command_lines(page: Path) -> Iterator[str]:
    """`ltm ...` in blocks of a shell (a comment that goes on below belongs to the command above), and in the text."""
    for block in blocks(page, "sh", "console"):
        line = ""
        for raw in block.text.splitlines():
            if raw.lstrip().startswith("#"):
                line += " " + raw.strip()
                continue
            if line:
                yield line
            line = raw.strip().removeprefix("$ ").removeprefix(".venv/bin/")
            line = line if line.startswith(PROGRAMS) else ""
        if line:
            yield line
    yield from (span for span in _SPAN.findall(prose(page)) if span.startswith(PROGRAMS))
    yield from re.findall(r"^ {4,}(ltm(?:-lab)? .*)$", prose(page), re.MULTILINE)


@cache
def described(program: str = "ltm") -> Any:
    """Return a command line as click knows it."""
    return typer.main.get_command(lab_cli if program == "ltm-lab" else cli)


def faults(line: str) -> list[str]:
    """What the command line does not know of a documented `ltm` line."""
    said, _, comment = line.partition(" #")
    path, *tokens = shlex.split(re.sub(r"[\[\]|\\]", " ", said))
    command = described(path)
    while tokens and hasattr(command, "commands"):
        name = command.name
        if tokens[0] in command.commands:
            chosen = tokens.pop(0)
        elif name in DEFAULTS and not tokens[0].startswith("-"):
            chosen = DEFAULTS[name]
        else:
            return [] if tokens[0] == "--help" or tokens[0].isupper() else [f"{path} has no command {tokens[0]!r}"]
        command, path = command.commands[chosen], f"{path} {chosen}"
    options = {name: option for option in command.params for name in (*option.opts, *option.secondary_opts)}
    wrong, arguments = [], 0
    while tokens:
        token, given, value = tokens.pop(0).partition("=")
        if token == "--help":
            continue
        if not re.match(r"--?[a-z]", token):
            arguments += 1
            continue
        if token not in options:
            return [f"{path} has no option {token}"]
        if not given and not options[token].is_flag:
            if tokens and tokens[0].startswith("--"):
                wrong.append(f"{path} {token} wants a value")
            elif tokens:
                value = tokens.pop(0)
        default = options[token].default
        choices = [member.value for member in type(default)] if isinstance(default, Enum) else []
        if choices and value.islower() and value not in choices:
            wrong.append(f"{path} {token} is one of {', '.join(choices)}, not {value!r}")
    places = [param.nargs for param in command.params if param.param_type_name == "argument"]
    if arguments > sum(places) and -1 not in places and not hasattr(command, "commands"):
        wrong.append(f"{path} takes {sum(places)} arguments, not {arguments}")
    if comment:
        wrong += [fault for other in _SPAN.findall(comment) if other.startswith(PROGRAMS) for fault in faults(other)]
        named = re.findall(r"(?<![\w-])--[a-z][a-z-]*", _SPAN.sub("", comment))
        wrong += [f"{path} has no option {name}" for name in named if name not in options]
    return wrong


def all_options(command: Any) -> set[str]:
    """Of a command and all below it."""
    own = {name for option in command.params for name in (*option.opts, *option.secondary_opts)}
    return own.union(*(all_options(below) for below in getattr(command, "commands", {}).values()))


def ids(page: Path) -> str:
    return str(page.relative_to(REPOSITORY))


@pytest.mark.parametrize("page", TODAYS, ids=ids)
def test_commands_and_options_exist(page: Path) -> None:
    assert [fault for line in command_lines(page) for fault in faults(line)] == []


def test_the_jobs_of_same_results_are_commands() -> None:
    jobs = yaml.safe_load((REPOSITORY / "tools/same_results_jobs/jobs.yaml").read_text(encoding="utf-8"))
    lines = [line for job in jobs for line in job["commands"] if line.startswith(PROGRAMS)]
    assert lines
    assert [fault for line in lines for fault in faults(line)] == []


@pytest.mark.parametrize("page", TODAYS, ids=ids)
def test_options_named_alone_exist(page: Path) -> None:
    named = {m for span in _SPAN.findall(prose(page)) for m in re.findall(r"^--[a-z][a-z-]*", span)}
    assert named - all_options(described()) - all_options(described("ltm-lab")) - FOREIGN == set()


@pytest.mark.parametrize("page", TODAYS, ids=ids)
def test_make_targets_exist(page: Path) -> None:
    targets = set(re.findall(r"^([a-z][a-z-]*):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    shell = "\n".join(block.text for block in blocks(page, "sh", "console"))
    named = re.findall(r"^make ([a-z][a-z-]*)", shell, re.MULTILINE)
    named += re.findall(r"`make ([a-z][a-z-]*)", prose(page))
    assert set(named) <= targets


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_links_lead_to_files(page: Path) -> None:
    targets = [target.partition("#")[0] for target in _LINK.findall(prose(page))]
    local = [target for target in targets if target and "://" not in target and not target.startswith("mailto:")]
    assert [target for target in local if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("root", ["ltm_core", "ltm_msgs_py", "ltm_ros", "config", "packaging", "bags", "examples"])
def test_pages_that_the_code_names_exist(root: str) -> None:
    files = [
        file for file in (REPOSITORY / root).rglob("*") if file.suffix in (".py", ".yaml", ".xml", ".md", ".service")
    ]
    named = {
        (ids(file), page)
        for file in files
        for page in re.findall(r"\bdocs/[\w/]+\.md", file.read_text(encoding="utf-8"))
    }
    assert {(file, page) for file, page in named if not (REPOSITORY / page).exists()} == set()


@pytest.mark.parametrize("page", TODAYS, ids=ids)
def test_named_files_exist(page: Path) -> None:
    """Paths from the repository's root, also with wildcards; modules named without their folder."""
    text = page.read_text(encoding="utf-8")
    roots = "|".join(map(re.escape, ROOTS))
    paths = re.findall(rf"(?<![\w./-])((?:{roots})/[\w./*-]*\w)", text)
    missing = [
        path for path in paths if not any(REPOSITORY.glob(re.sub(r"(?<![a-zA-Z])[A-Z]{2,}(?![a-z])", "*", path)))
    ]
    modules = re.findall(r"(?<![\w./-])([a-z]\w*\.py)\b", "".join(f"{span}\n" for span in _SPAN.findall(prose(page))))
    assert missing + [module for module in modules if module not in python_files()] == []


@cache
def python_files() -> frozenset[str]:
    """Names of all of the repository's."""
    return frozenset(file.name for root in ROOTS for file in (REPOSITORY / root).rglob("*.py")) | {"setup.py"}


@pytest.mark.parametrize("page", TODAYS, ids=ids)
def test_python_names_exist(page: Path) -> None:
    """Dotted names of our packages, in text and in the API pages (`::: ltm_core.raster.dem.Dem`)."""
    text = page.read_text(encoding="utf-8")
    for name in set(re.findall(r"(?:`|::: |\]\[)((?:ltm_core|ltm_msgs_py|ltm_ros|ltm_lab)(?:\.\w+)+)", text)):
        assert resolves(name), name


def resolves(name: str) -> bool:
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            annotated = part in getattr(found, "__annotations__", {})
            if not hasattr(found, part) and not annotated:
                return False
            found = getattr(found, part, None)
        return True
    return False


SITE_KEYS = set(Site.model_fields)


@pytest.mark.parametrize("page", TODAYS, ids=ids)
def test_yaml_keys_exist(page: Path, tmp_path: Path) -> None:
    """YAML that is a pose file, a region, data sources, a site or a part of one has no unknown key."""
    for block in blocks(page, "yaml"):
        given = yaml.safe_load(block.text)
        if not isinstance(given, dict):
            continue
        if {"pose", "calibration"} <= given.keys():
            PictureConfig.model_validate(given)
        elif "towers" in given:
            RegionConfig.model_validate(given)
        elif "sources" in given:
            (tmp_path / "own.yaml").write_text(block.text, encoding="utf-8")
            load_sources(tmp_path / "own.yaml")
        elif given.keys() <= SITE_KEYS | {"expert"}:
            whole = {"name": "a", "crs": "EPSG:32611", "origin": [0, 0], "dem": {"path": "d.tif"}, "cameras": {"a": {}}}
            site = Site.model_validate(with_expert(Site, whole | given))
            for node, parameters in site.nodes.items():
                config = importlib.import_module(f"ltm_ros.nodes.{node}").NODE.config
                assert set(parameters) <= set(config.model_fields), node
        else:
            assert "kind" in given, f"neither a site nor a pose file nor depth_maps.yaml: {sorted(given)}"


WITHOUT_COMMAND = ("accuracy", "glossary")
"""Pages of docs that are no tasks."""
TASKS = [page for page in sorted((REPOSITORY / "docs").glob("*.md")) if page.stem not in WITHOUT_COMMAND]


@pytest.mark.parametrize("page", TASKS, ids=ids)
def test_a_page_opens_with_a_command(page: Path) -> None:
    title, _, text = page.read_text(encoding="utf-8").partition("\n")
    assert title.startswith("# ")
    opening = text.partition("\n## ")[0]
    assert "```sh\n" in opening
    assert "\n|" not in opening.partition("```sh\n")[0], "tables come after the first command"


MOST_WORDS = {"README.md": 900, "CHANGELOG.md": 1500, "docs/**/*.md": 25_000, "ltm_lab/README.md": 700}


@pytest.mark.parametrize("pattern", MOST_WORDS)
def test_the_pages_are_short(pattern: str) -> None:
    pages = list(REPOSITORY.glob(pattern))
    words = {ids(page): len(page.read_text(encoding="utf-8").split()) for page in pages}
    assert words
    assert sum(words.values()) <= MOST_WORDS[pattern], words


def test_the_readmes_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the demo's first photo and its DEM: it prints what it found, and what it names has the stated shapes."""
    demo = project_path("bags/demo")
    reader = BagReader(demo / "recording")
    message = next(reader.messages(["/demo/tower_north/image_raw/compressed"]))
    photo = compressed_to_rgb(reader.decode(message))
    (tmp_path / "photo.jpg").write_bytes(encode_rgb(photo))
    (tmp_path / "dem.tif").symlink_to(demo / "dem.tif")
    monkeypatch.chdir(tmp_path)
    (example,) = blocks(REPOSITORY / "README.md", "python")
    lines = [line for line in example.text.splitlines() if line.strip() and not line.startswith(("import", "from"))]
    assert len(lines) <= 10
    names: dict[str, Any] = {}
    exec(compile(example.text, "README.md", "exec"), names)
    height, width = photo.shape[:2]
    assert names["depth"].shape == (height, width)
    assert names["points"].shape == (height, width, 3)
    assert names["cells"].shape == (height, width, 2)
    assert 0.5 < names["seen"].mean() < 0.9
