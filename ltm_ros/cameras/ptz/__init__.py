"""Read the directions of pan-tilt-zoom (PTZ) heads, by maker."""
