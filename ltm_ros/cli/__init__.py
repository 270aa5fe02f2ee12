"""The command `ltm`, one module a command."""
