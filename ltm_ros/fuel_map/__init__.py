"""Parts of the node `fuel_map` (persistence, publisher, services, terrain changes), and images of the map."""
