import re
from pathlib import Path

from ltm_core.base.resources import project_path

ROOTS = ("ltm_core", "ltm_msgs_py", "ltm_ros", "docs", "README.md", "CONTRIBUTING.md", "config", "examples")
SUFFIXES = (".py", ".md", ".yaml", ".html")
PHRASES = (
    "it is worth",
    "(?:is|are|was|were|be) told",
    "tells of",
    "speaks for",
    "cameras? looks? at",
    "one who",
    "so many",
    "(?:map|surface|terrain|pose) as it (?:is|was)",
    "(?:made|make|makes) anew",
    "worked again",
    "mend(?:s|ed)?",
    "hangs on",
    "stands in (?:the|this|that|its|a) (?:file|manifest|folder|store|section|site file)",
    "by a script",
    "of its own accord",
    "nobody",
    "somebody",
    "what is seen of",
    "let in at the door",
    "as far as it",
)
FOUND = re.compile(rf"\b(?:{'|'.join(PHRASES)})\b".replace(" ", r"\s+(?:#\s+)?"), re.IGNORECASE)


def files(root: str) -> list[Path]:
    """Return the text files of a root."""
    path = project_path(root)
    return [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.suffix in SUFFIXES)


def found_in(path: Path) -> list[str]:
    """Return file, line and phrase of every match, also of those that a line break divides."""
    text = path.read_text(encoding="utf-8")
    return [f"{path}:{text.count(chr(10), 0, m.start()) + 1}: {' '.join(m[0].split())!r}" for m in FOUND.finditer(text)]


def test_no_phrase_of_the_dialect() -> None:
    found = [match for root in ROOTS for path in files(root) for match in found_in(path)]
    assert not found, "write it plainly:\n" + "\n".join(found)
