"""The public functions of ``import frogkick as fk``, which the commands call as well, one for each task."""
