"""What stands behind ``import frogkick as fk`` and below the commands: objects in memory, one call a task."""
