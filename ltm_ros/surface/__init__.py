"""Parts of the node `terrain`, and the confirmed surface for the nodes that trace."""
