"""A closed-loop run: fixes in, strokes out; its log; recorded runs."""
