"""The real graph of a small site under faults that chance draws, and over hours: `make chaos`, `make soak`."""
