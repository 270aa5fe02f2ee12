"""`ltm import`: photos with a pose file or EXIF become a recording that the graph replays."""
