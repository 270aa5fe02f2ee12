"""The fuel map: votes of one frame, evidence over frames and cameras, and the decision what grows in each cell."""
