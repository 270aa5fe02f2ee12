"""Fire spread over a landscape before and after an update of its map: scenario and spread model."""
