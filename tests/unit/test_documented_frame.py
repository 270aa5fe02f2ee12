import ast
import re
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
PAGE = REPOSITORY / "docs/how/one_frame.md"
FILES = re.findall(r"^\d+\. `([\w/]+\.py)` ", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def imported(file: str) -> set[str]:
    """Return the repository's files that a file imports."""
    tree = ast.parse((REPOSITORY / file).read_text(encoding="utf-8"))
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    return {f"{module.replace('.', '/')}.py" for module in modules}


def test_at_most_twelve_files() -> None:
    assert 10 <= len(FILES) <= 12
    assert len({*FILES}) == len(FILES)


def test_the_list_is_one_chain() -> None:
    """Every file but the first is linked to a file further up, or to the next one."""
    for number, file in enumerate(FILES[1:], 1):
        near = FILES[: number + 2]
        assert any(file in imported(other) or other in imported(file) for other in near if other != file), file
