"""Transfer from a tower to the map of its region: outbox and thinning, envelope, grids of other sites."""
