"""Traced, network and fused depth against true depth."""
