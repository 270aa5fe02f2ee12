"""Study wing: measures of depth, labels, maps and skylines against truth."""
