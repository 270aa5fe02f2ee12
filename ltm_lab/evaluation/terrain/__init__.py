"""Study wing: scores of the surface map on exact scenes, simulated frames and a real site with later surveys."""
