"""frogkick: plan for small robots that move by strokes, on the robot itself."""

__version__ = "0.1.0"
