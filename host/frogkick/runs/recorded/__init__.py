"""The paper's recorded closed-loop runs (Huang 2022) as run logs."""
