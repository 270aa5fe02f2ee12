"""What the node `terrain` says of its map."""
