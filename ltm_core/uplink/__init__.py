"""What a tower sends to the map of its region: outbox and thinning, envelope, grids of other sites."""
