"""`python -m chaos [--minutes 30] [--seed N] [--soak] [--json FILE]`; see `ltm_lab/records/2026-11-security.md`."""

from chaos.command import main

main()
