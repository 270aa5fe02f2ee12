"""Make recordings from photos with a pose file or EXIF (`ltm import`), which the graph can replay."""
