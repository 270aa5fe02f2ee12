"""How well places are located: geometric smoke over terrain with known truth, and surveyed control points."""
