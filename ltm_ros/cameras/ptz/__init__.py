"""PTZ heads of pan-tilt-zoom cameras: what they say of their direction, by maker."""
