"""The fuel map: votes of a frame, evidence over frames and cameras, and the decision on the fuel code of each cell."""
