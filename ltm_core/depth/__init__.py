"""TopoDepth: depth traced to the terrain fused with a monocular network's. Start at `topodepth`."""
