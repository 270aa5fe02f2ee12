"""The command `ltm`: one module per command."""
