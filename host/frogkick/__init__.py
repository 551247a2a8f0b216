"""frogkick: plan for small robots that move by strokes, on the robot itself."""

import os

__version__ = "0.1.0"

# Installed for all users: numba keeps what it compiles in this user's folder.
if not os.access(os.path.dirname(__file__), os.W_OK):
    from frogkick.files import cache_folder

    os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_folder("numba")))
