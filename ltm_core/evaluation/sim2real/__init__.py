"""How far simulated pictures are from real ones."""
