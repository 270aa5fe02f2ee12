"""Manage an installed tower: its releases, its service, upgrades and rollback."""
