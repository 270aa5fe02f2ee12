"""Describe a site's graph and run it as processes: start, supervision, shutdown and cleanup."""
