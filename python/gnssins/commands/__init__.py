"""What the commands do, one module per family; :mod:`gnssins.cli` only parses."""
