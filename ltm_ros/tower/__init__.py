"""A tower as an installed thing: its releases, the service that runs one of them, upgrades and the way back."""
