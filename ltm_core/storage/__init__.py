"""Files and their limits: text, YAML, photos, disk space, and the SQLite store of map tiles."""
