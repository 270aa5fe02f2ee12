"""The steps of one frame in order, and the maps of a site that they fill."""
