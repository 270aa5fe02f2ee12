"""Parts of the node `fuel_map` (persistence, publisher, services, changes of the terrain), and pictures of the map."""
