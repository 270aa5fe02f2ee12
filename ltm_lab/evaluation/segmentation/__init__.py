"""Study wing: scores of label networks on labelled frames."""
