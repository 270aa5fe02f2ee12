"""Study wing: training of the segmentation network, and of fitted constants (needs the extra `train`)."""
