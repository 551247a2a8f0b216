"""A simulated pool: swimmer, camera, and robots to steer it, among them the virtual chip."""
