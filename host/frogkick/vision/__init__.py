"""Camera to pose: calibration, tag, sources of pictures, pose in the pool's frame. README.md orients.

What cannot be used (a file, a picture, a value, a device) raises ``InputError`` everywhere here.
"""
