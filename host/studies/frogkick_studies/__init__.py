"""Questions about the method, answered with figures (``frogkick study``)."""
