"""The laboratory: evaluation, training, simulator and benchmarks. It imports the product; the product never imports it."""
