"""The inverse of tracing: which map points a camera sees, what cameras cover, how well a pixel is placed."""
