"""`ltm-lab bench slow-link`: `ltm view --connect` over a slow link."""

from typing import Annotated

import typer

from ltm_lab.cli.bench.runs import numbers, print_table


def slow_link(
    cameras: Annotated[str, typer.Option(help="Numbers of cameras.")] = "1,4,12",
    seconds: Annotated[float, typer.Option(help="Length of each run, s.", min=15)] = 30.0,
    mbit: Annotated[float, typer.Option(help="Rate of the link, Mbit/s.", min=0.1)] = 1.0,
    round_trip: Annotated[float, typer.Option(help="Round-trip time of the link, s.", min=0)] = 0.3,
) -> None:
    """Show a tower over a slow link between two network namespaces. Needs root."""
    from rich.console import Console

    from ltm_lab.bench.slow_link import measure_slow_link

    counts = [round(value) for value in numbers(cameras)]
    results = [measure_slow_link(count, seconds, mbit, round_trip) for count in counts]
    rows = [
        ("first image, s", *(f"{result.first_s:.1f}" for result in results)),
        ("most behind the newest frame, s", *(f"{result.behind_s:.1f}" for result in results)),
        ("most in a second, Mbit/s", *(f"{result.mbit_s:.2f}" for result in results)),
        ("listening sockets on the laptop", *(", ".join(result.listening) for result in results)),
    ]
    heads = ("", *(f"{count} cameras" for count in counts))
    title = f"a tower over {mbit:g} Mbit/s with {round_trip:g} s round trip; TLS and token"
    print_table(Console(), title, heads, rows, "frames: each camera once a second; a wrong token was rejected")
