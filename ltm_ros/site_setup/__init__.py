"""Set up a site: fetch its rasters, convert them and write the site file (`ltm init`)."""
