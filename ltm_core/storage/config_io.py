"""Read YAML, text and NumPy files within bounds, and check them against typed models."""

import contextlib
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Collection, Hashable, Sequence
from copy import deepcopy
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import yaml
from numpy.lib.format import read_array
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.base.redaction import shown
from ltm_core.base.strict_model import with_expert

LARGEST_TABLE = 4 << 20
"""Maximum size in bytes of a CSV file or of an index in JSON."""


def read_text(path: Path, most: int, error: type[LtmError], encoding: str = "utf-8") -> str:
    """Return the whole of a text file. Raises `error` for a missing file, more than `most` bytes, or invalid
    `encoding`."""
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as reason:  # ValueError: a name that no file can have
        raise error(f"{path}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from reason
    if len(content) > most:
        raise error(f"{path}: cannot be read (it has more than {most} bytes); split it")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as reason:
        raise error(f"{path}: cannot be read (not text in UTF-8: {reason}); save it as UTF-8") from reason


_BROKEN_FILE = (
    *(OSError, ValueError, TypeError, LookupError, EOFError, SyntaxError, MemoryError, OverflowError),
    *(RuntimeError, zlib.error, zipfile.BadZipFile, tokenize.TokenError),
)
"""Errors that NumPy, the header's parser and zipfile raise for damaged bytes."""


def load_array(content: bytes, what: str, error: type[LtmError]) -> NDArray[Any]:
    """Return an array from the bytes of an .npy file; `what` names it in errors. Raises `error` for other bytes, a
    wrong size, and Python objects."""
    try:
        return read_array(BytesIO(content), allow_pickle=False)
    except _BROKEN_FILE as reason:
        raise error(f"{what} is damaged: not a NumPy array ({type(reason).__name__}: {reason})") from reason


def load_arrays(path: Path, names: Sequence[str], most_bytes: int, error: type[LtmError]) -> list[NDArray[Any]]:
    """Return these arrays of an .npz file. Raises `error` for a missing file or array, or more than `most_bytes`."""
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = []
            for name in names:
                entry = archive.getinfo(f"{name}.npy")
                if entry.file_size > most_bytes:
                    raise ValueError(f"{name} has {entry.file_size} bytes, at most {most_bytes} are read")
                with archive.open(entry) as stream:
                    arrays.append(read_array(stream, allow_pickle=False))
            return arrays
    except _BROKEN_FILE as reason:
        raise error(f"{path}: expected an .npz with {', '.join(names)} ({type(reason).__name__}: {reason})") from reason


LARGEST_FILE = 512 << 10
"""Maximum file size in bytes, parsed in about two seconds. The largest shipped file has 20 kB, a site with 50 cameras
30 kB."""
LARGEST_DEPTH = 40
"""Maximum nesting of mappings and lists."""
MOST_VALUES = 100_000
"""Maximum number of keys and values, counting those that an alias repeats each time."""
LONGEST_NUMBER = 40
"""Maximum number of characters of an integer; Python's conversion of longer ones takes seconds or fails."""
LARGEST_KEPT = 32 << 10
"""Maximum number of characters of a text whose values are cached, for the last `_KEPT` texts. A process reads the same
labels, models and site many times, and copying values is faster than parsing."""
_KEPT = 64

_BROKEN = (*(yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError), *(OverflowError, RecursionError))
"""Errors that PyYAML raises, including unintended ones: dates such as 2001-13-45 (ValueError), `!!int ""` (IndexError),
`!!bool x` (KeyError), `!!timestamp x` (AttributeError), characters beyond Unicode (OverflowError)."""


class _BoundedLoader(yaml.SafeLoader):
    """Loader that rejects repeated keys (PyYAML would drop all but the last, perhaps a whole camera), too deep nesting
    and too many repetitions."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._open: list[int] = []
        """Number of values so far in each node being composed, outermost first."""
        self._values: dict[int, int] = {}
        """Number of values in each composed node, by its identity."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        if self.check_event(yaml.AliasEvent):
            node = super().compose_node(parent, index)
            if id(node) not in self._values:
                raise yaml.composer.ComposerError(None, None, "an alias that contains itself", mark)
            values = self._values[id(node)]
        else:
            if len(self._open) >= LARGEST_DEPTH:
                raise yaml.composer.ComposerError(None, None, f"nested deeper than {LARGEST_DEPTH}", mark)
            self._open.append(1)
            node = super().compose_node(parent, index)
            values = self._values[id(node)] = self._open.pop()
        if self._open:
            self._open[-1] += values
            if self._open[-1] > MOST_VALUES:
                raise yaml.composer.ComposerError(None, None, f"more than {MOST_VALUES} values", mark)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        "in a mapping", node.start_mark, f"the key {key.value!r} is repeated", key.start_mark
                    )
                seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_scalar(self, node: Any) -> Any:
        value = super().construct_scalar(node)
        if isinstance(value, str) and any(c == "\0" or "\ud800" <= c <= "\udfff" for c in value):
            raise yaml.constructor.ConstructorError(None, None, "an invalid character", node.start_mark)
        return value

    def construct_yaml_int(self, node: Any) -> int:
        if len(str(node.value)) > LONGEST_NUMBER:
            raise yaml.constructor.ConstructorError(
                None, None, f"a number of more than {LONGEST_NUMBER} characters", node.start_mark
            )
        return int(super().construct_yaml_int(node))


_BoundedLoader.add_constructor("tag:yaml.org,2002:int", _BoundedLoader.construct_yaml_int)


def parse_yaml(text: str, place: str) -> Any:
    """Parse a YAML text into a new object; `place`: the file, for the message. Raises ConfigError for invalid YAML,
    repeated keys, or content beyond the limits above."""
    if len(text) <= LARGEST_KEPT:
        with contextlib.suppress(ConfigError):  # said below with the place
            return deepcopy(_kept(text))
    return _read(text, place, lambda loader: loader.get_single_data())


@lru_cache(maxsize=_KEPT)
def _kept(text: str) -> Any:
    return _read(text, "", lambda loader: loader.get_single_data())


def compose_yaml(text: str, place: str) -> yaml.Node | None:
    """Return the nodes of a YAML text, which say where each value stands. Raises ConfigError as `parse_yaml` does."""
    parse_yaml(text, place)
    return _composed(text, place)


def line_of(path: Path, keys: Sequence[int | str]) -> int | None:
    """Return the line of a key in a YAML file that `read_yaml` has read; missing sections are skipped. None if the key
    is missing."""
    node = _composed(read_text(path, LARGEST_FILE, ConfigError), str(path))
    line = None
    for key in keys:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
            node = node.value[key]
            line = node.start_mark.line + 1
        elif isinstance(node, yaml.MappingNode):
            for name, value in node.value:
                if name.value == str(key):
                    node, line = value, name.start_mark.line + 1
                    break
    return line


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML file. Raises ConfigError as `parse_yaml` does, and if the file cannot be read."""
    return parse_yaml(read_text(path, LARGEST_FILE, ConfigError), str(path))


def _composed(text: str, place: str) -> yaml.Node | None:
    node: yaml.Node | None = _read(text, place, lambda loader: loader.get_single_node())
    return node


def _read(text: str, place: str, take: Callable[[_BoundedLoader], Any]) -> Any:
    if len(text) > LARGEST_FILE:
        raise ConfigError(f"{place}: not YAML (more than {LARGEST_FILE} characters)")
    try:
        return take(_BoundedLoader(text))
    except _BROKEN as error:
        raise ConfigError(f"{place}: not YAML ({error or type(error).__name__})") from error


Model = TypeVar("Model", bound=BaseModel)
Keys = tuple[int | str, ...]


def load_yaml(path: Path | str, model: type[Model]) -> Model:
    """Read a YAML mapping into `model`. Raises ConfigError: no file, no YAML, keys unknown or twice, wrong values."""
    path = Path(path)
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected a mapping of keys to values, got {type(content).__name__}")
    try:
        whole = with_expert(model, content)
    except ConfigError as error:
        raise ConfigError(f"{path}:\n{error}") from error
    tuned = content.get("expert") or {}
    return checked(
        model, whole, str(path), lambda keys: line_of(path, ("expert", *keys) if _stands_in(tuned, keys) else keys)
    )


def _stands_in(section: Any, keys: Keys) -> bool:
    for key in keys:
        section = section.get(key) if isinstance(section, dict) else None
    return section is not None


def checked(
    model: type[Model],
    content: object,
    place: str,
    line_of: Callable[[Keys], int | None] = lambda keys: None,
    unnamed: Collection[str] = (),
) -> Model:
    """Return `content` as a `model`. Raises ConfigError with every invalid key and its value.

    `line_of`: where in the file a key stands. `unnamed`: sections of the model that the file does not write, such as
    those of the columns of a CSV."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        known = ", ".join(model.model_fields)
        lines = []
        for item in error.errors():
            key = ".".join(str(part) for part in item["loc"] if part not in unnamed) or "(all)"
            line = line_of(item["loc"])
            at = "" if line is None else f", line {line}"
            if item["type"] == "extra_forbidden":
                lines.append(f"  {key}: unknown key{at}" + (f"; known keys: {known}" if len(item["loc"]) == 1 else ""))
            elif item["type"] == "missing":
                lines.append(f"  {key}: missing")
            else:
                lines.append(f"  {key}: {item['msg']} (got {shown(item['input'], item['loc'])}{at})")
        raise ConfigError("\n".join([f"{place}:", *lines])) from error
