"""The laboratory: evaluation, training, simulator and benchmarks. The product never imports it."""
