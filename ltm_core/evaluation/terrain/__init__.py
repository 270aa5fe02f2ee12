"""The surface map against truth: exact hillsides, simulated frames, a real site with later surveys."""
