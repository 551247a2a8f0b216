"""Camera to pose: calibration, tag, sources of pictures, pose in the pool's frame. README.md orients."""
