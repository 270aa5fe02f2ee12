"""The parts of the node `fuel_map`: its store, what it publishes, its services, the terrain's changes."""
