"""The Rerun view of a site. It takes core types, so that it shows a recording or a script's results as well."""

from ltm_ros.viewer.view import RerunView

__all__ = ["RerunView"]
