"""Train a label head on a few labelled photos of a site, and score it on held-out photos."""
