"""The Rerun view of a site. It takes core types, so that it can also show a recording or results of your
own program."""

from ltm_ros.viewer.view import RerunView

__all__ = ["RerunView"]
