"""Fire spread over a landscape before and after an update of its map: scenario, spread model, ensemble."""
