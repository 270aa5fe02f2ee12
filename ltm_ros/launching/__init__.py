"""Describes a site's graph and runs it as processes: start, supervision, shutdown and cleanup."""
