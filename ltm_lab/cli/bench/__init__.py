"""`ltm-lab bench`: measure the cost of tracing, of the site graph, of archives and of commands."""

import typer

from ltm_lab.cli.bench.archive import archive
from ltm_lab.cli.bench.graph import graph
from ltm_lab.cli.bench.kernels import kernels
from ltm_lab.cli.bench.memory import memory
from ltm_lab.cli.bench.slow_link import slow_link
from ltm_lab.cli.bench.trace import trace

bench = typer.Typer(
    help="Measure time and memory: the tracer beside others, the site graph, archives, commands, a slow link.",
    no_args_is_help=True,
)
bench.command()(trace)
bench.command()(graph)
bench.command()(archive)
bench.command()(memory)
bench.command()(slow_link)
bench.command()(kernels)
