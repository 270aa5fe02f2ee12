"""Parts of the node `terrain`, and the surface that it confirms for the nodes that trace."""
