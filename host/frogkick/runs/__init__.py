"""Closed-loop runs, their logs, and the paper's recorded runs."""
