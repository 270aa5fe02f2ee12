"""The surface that `terrain` confirms, and the nodes that trace depth to it."""
