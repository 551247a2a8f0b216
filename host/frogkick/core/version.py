"""Which frogkick this is."""

VERSION = "0.1.0"
