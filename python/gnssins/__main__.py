"""``python -m gnssins``."""

from gnssins.cli import main

main()
