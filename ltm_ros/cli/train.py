"""`ltm train`: teaches a label network what grows at a site of your own."""

from __future__ import annotations

import typer

from ltm_ros.cli.train_head import head

train = typer.Typer(no_args_is_help=True, help="Teach a label network a place from a few labelled photos.")


@train.callback()
def _commands() -> None:
    """Keep `head` a command of its own while it is the only one."""


train.command()(head)
