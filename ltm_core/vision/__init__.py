"""What a camera sees, pixel by pixel: label taxonomy, networks behind manifests, segmentation, training."""
