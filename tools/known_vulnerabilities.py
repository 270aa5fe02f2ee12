"""Asks for known vulnerabilities of the pinned packages: `python tools/known_vulnerabilities.py constraints.txt`.

pip-audit does the work. This says besides what its answer is worth: offline, behind a mirror, or for packages that PyPI
does not have, pip-audit finds nothing because it could ask nothing, and says "No known vulnerabilities found" all the
same.

Exits with 1 where a vulnerability is known; with 0 where none is, and also where nobody could be asked, which it says.
"""

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

PROBE = "requests==2.19.0"
"""A release with advisories that have been published for years: whoever knows none of it is no source."""
PATIENCE_S = 900


@dataclass
class Answer:
    """`error`: why there is none at all. Packages as `name version`."""

    clean: list[str] = field(default_factory=list)
    vulnerable: dict[str, list[str]] = field(default_factory=dict)
    """With the advisories, and the versions that mend them."""
    unanswered: list[str] = field(default_factory=list)
    error: str = ""


def read_answer(output: str) -> Answer:
    """What pip-audit has written as JSON."""
    answer = Answer()
    try:
        for package in json.loads(output)["dependencies"]:
            name = f"{package['name']} {package.get('version', '')}".strip()
            if "skip_reason" in package:
                answer.unanswered.append(name)
            elif package["vulns"]:
                answer.vulnerable[name] = [
                    f"{one['id']}, mended in {', '.join(one['fix_versions']) or 'no version'}"
                    for one in package["vulns"]
                ]
            else:
                answer.clean.append(name)
    except (ValueError, KeyError, TypeError):
        return Answer(error="pip-audit has given no answer that can be read")
    return answer


def ask(requirements: Path) -> Answer:
    """pip-audit's answer for a file of pinned requirements; nothing is installed or resolved."""
    command = [sys.executable, "-m", "pip_audit", "--requirement", str(requirements), "--no-deps", "--disable-pip"]
    command += ["--format", "json", "--progress-spinner", "off", "--timeout", "15"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        return Answer(error=f"no answer within {PATIENCE_S} s")
    answer = read_answer(done.stdout)
    if answer.error and done.stderr.strip():
        answer.error = done.stderr.strip().splitlines()[-1]
    return answer


def report(answer: Answer) -> tuple[str, int]:
    """What to say, and the exit status."""
    lines = [f"{name}: {one}" for name, advisories in answer.vulnerable.items() for one in advisories]
    asked = len(answer.clean) + len(answer.vulnerable)
    lines.append(f"{asked} packages looked up, {len(answer.vulnerable)} of them with known vulnerabilities")
    if answer.unanswered:
        lines.append(f"nothing is known of {len(answer.unanswered)} others: {', '.join(answer.unanswered)}")
    return "\n".join(lines), 1 if answer.vulnerable else 0


def _not_asked(why: str) -> int:
    print(f"NOT ASKED for known vulnerabilities: {why}. Nothing is said about the packages; run it where PyPI answers.")
    return 0


def main(constraints: Path) -> int:
    with tempfile.TemporaryDirectory() as folder:
        probe = Path(folder) / "probe.txt"
        probe.write_text(f"{PROBE}\n", encoding="utf-8")
        known = ask(probe)
    if not known.vulnerable:
        return _not_asked(known.error or f"the index here knows no advisory even of {PROBE}")
    answer = ask(constraints)
    if answer.error:
        return _not_asked(answer.error)
    text, status = report(answer)
    print(text)
    return status


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
