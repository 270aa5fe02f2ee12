"""The command `ltm-lab`, one module a command."""
