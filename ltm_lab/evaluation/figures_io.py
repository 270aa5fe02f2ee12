"""Former place of `ltm_ros.pages.figures_io`."""

from ltm_ros.pages.figures_io import write_figures

__all__ = ["write_figures"]
