"""Show a site in Rerun. The view takes core types, so that it can also show results of your own program."""

from ltm_ros.viewer.view import RerunView

__all__ = ["RerunView"]
