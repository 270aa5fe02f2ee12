"""`ltm-lab bench kernels`: processor time to compile the kernels."""

from typing import Annotated

import typer


def kernels(
    kind: Annotated[list[str] | None, typer.Option(help="Kind of node, as depth. Repeatable. Default: all.")] = None,
    shown: Annotated[int, typer.Option(min=1, help="Number of kernels to list.")] = 25,
) -> None:
    """List the kernels that take longest to compile, and their sum; and the processor time of `ltm trace`."""
    from rich.console import Console

    from ltm_core.pipeline.kernels import KERNELS
    from ltm_lab.bench.kernels import compile_times, trace_command_costs
    from ltm_ros.cli.output import print_table

    console = Console()
    rows = compile_times(kind or KERNELS)
    listed = [(row.name.replace(".<locals>", ""), f"{row.own_s:.2f}", str(row.signatures)) for row in rows[:shown]]
    print_table("kernels", ("kernel", ">own s", ">signatures"), listed)
    foreign = sum(row.own_s for row in rows if not row.name.startswith("ltm_"))
    total = sum(row.own_s for row in rows)
    console.print(
        f"{len(rows)} functions, {total:.1f} s of processor time, {foreign:.1f} s of it for functions of numba"
    )
    cold, *warm = trace_command_costs(runs=4)
    least = min(warm, key=lambda cost: cost.whole_s - cost.traced_s)
    console.print(
        f"ltm trace, 1080p: {cold.whole_s:.1f} s of processor time with no kernel compiled; with all, "
        f"{least.traced_s:.2f} s for the trace and {least.whole_s - least.traced_s:.2f} s besides"
    )
