"""Inference of image networks: label taxonomy, model manifests, ONNX models and segmentation of photos."""
