"""Pictures that only evaluations draw."""
