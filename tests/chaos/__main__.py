"""`python -m chaos [--minutes 30] [--seed N] [--soak] [--json FILE]`; see `docs/security.md`."""

from chaos.command import main

main()
