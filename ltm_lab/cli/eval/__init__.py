"""`ltm-lab eval`: scores against truth. `ltm-lab eval BAG` scores a recorded run, the others one part each.

A part is one module `ltm_lab/cli/eval/<part>.py` with a function of the same name, which imports what it needs when it
runs.
"""

import typer
from typer.core import TyperGroup

from ltm_lab.cli.eval.areas import areas
from ltm_lab.cli.eval.assessment import assessment
from ltm_lab.cli.eval.bag import bag
from ltm_lab.cli.eval.depth import depth
from ltm_lab.cli.eval.fuel import fuel
from ltm_lab.cli.eval.gallery import gallery
from ltm_lab.cli.eval.lens import lens
from ltm_lab.cli.eval.locate import locate
from ltm_lab.cli.eval.photo import photo
from ltm_lab.cli.eval.pose import pose
from ltm_lab.cli.eval.pose_watch import pose_watch
from ltm_lab.cli.eval.segmentation import segmentation
from ltm_lab.cli.eval.sim2real import sim2real
from ltm_lab.cli.eval.terrain import terrain
from ltm_lab.cli.eval.update import update

WHOLE = "bag"
"""The command that runs where the first argument is no command: a recorded run as a whole."""


class EvalGroup(TyperGroup):
    """A group whose default command is `bag`: `ltm-lab eval out/demo/recording`."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        if args and args[0] not in self.commands and not {"--help", "-h"} & set(args[:1]):
            args = [WHOLE, *args]
        return super().parse_args(ctx, args)


evaluate = typer.Typer(cls=EvalGroup, no_args_is_help=True, help="Score a recorded run, or one part of the system.")
evaluate.command(WHOLE)(bag)
evaluate.command()(assessment)
evaluate.command()(areas)
evaluate.command()(depth)
evaluate.command()(fuel)
evaluate.command()(gallery)
evaluate.command()(photo)
evaluate.command()(pose)
evaluate.command()(pose_watch)
evaluate.command()(lens)
evaluate.command()(locate)
evaluate.command()(segmentation)
evaluate.command()(sim2real)
evaluate.command()(terrain)
evaluate.command()(update)
