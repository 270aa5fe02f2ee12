"""A site's graph as processes: described, started, watched, ended, and nothing left behind."""
