"""Training of the segmentation network on rendered frames (needs the extra `train`)."""
