from pathlib import Path

import pytest
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError
from ltm_ros.cli import main
from ltm_ros.region.certs import TrialAuthority


def made(folder: Path, *options: str) -> set[str]:
    """Names of the files that the command says it wrote."""
    result = CliRunner().invoke(main.cli, ["certs", str(folder), "--region", "kern", *options])
    assert result.exit_code == 0, result.output
    assert "PRIVATE" not in result.output
    return {Path(line.removeprefix("wrote ")).name for line in result.output.splitlines() if line.startswith("wrote ")}


def test_keys_are_for_their_owner_alone_and_what_is_there_stays(tmp_path: Path) -> None:
    folder = tmp_path / "certs"
    pairs = {f"{name}.{kind}" for name in ("ca", "broker", "aggregator", "alta", "desk") for kind in ("crt", "key")}
    assert made(folder, "--tower", "alta", "--tower", "desk") == pairs | {"mosquitto.conf", "acl"}
    assert {path.stat().st_mode & 0o077 for path in folder.glob("*.key")} == {0}
    assert "listener 8883 127.0.0.1\n" in (folder / "mosquitto.conf").read_text()
    (folder / ".bear.key.new").write_text("left by a stop in the midst")  # as the umask has it
    (folder / ".bear.key.new").chmod(0o644)
    assert made(folder, "--tower", "bear") == {"bear.crt", "bear.key"}
    assert not (folder / ".bear.key.new").exists()
    assert (folder / "bear.key").stat().st_mode & 0o777 == 0o600
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert made(folder, "--tower", "alta") == set()
    assert made(folder, "--tower", "crow") == {"crow.crt", "crow.key"}
    assert {name: (folder / name).read_bytes() for name in before} == before


@pytest.mark.parametrize("name", ["ca", "bear"])
def test_a_key_without_a_certificate_is_not_overwritten(tmp_path: Path, name: str) -> None:
    (tmp_path / f"{name}.key").write_text("a key of the user")
    with pytest.raises(ConfigError, match=rf"{name}\.key"):
        TrialAuthority(tmp_path, 2).make("kern", ["bear"], [], "127.0.0.1", 8883)
    assert (tmp_path / f"{name}.key").read_text() == "a key of the user"


@pytest.mark.parametrize("name", ["aggregator", "ca", "broker", "#", "+", "Alta", "a/b", "x" * 64, ""])
def test_names_that_would_be_another_or_a_pattern_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="a name consists of a-z"):
        TrialAuthority(tmp_path, 2).make("kern", [name], [], "127.0.0.1", 8883)
    assert list(tmp_path.iterdir()) == []


def test_another_authority_in_the_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "ca.crt").write_text("not ours")
    (tmp_path / "ca.key").write_text("not ours")
    with pytest.raises(ConfigError, match="contains no authority"):
        TrialAuthority(tmp_path, 2).make("kern", ["alta"], [], "127.0.0.1", 8883)
