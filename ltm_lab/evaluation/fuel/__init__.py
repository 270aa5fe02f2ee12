"""Study wing: scores of the fuel map against truth, in simulated trials and on recorded runs."""
