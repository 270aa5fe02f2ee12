"""Study wing: scores of traced, network and fused depth against true depth."""
