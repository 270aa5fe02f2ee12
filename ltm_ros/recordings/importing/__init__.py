"""`ltm import`: makes a recording that the graph replays from photos with a pose file or EXIF."""
