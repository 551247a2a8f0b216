"""Table images (``.fkt``): their layout, packing, reading and checking.

All functions raise TableError for what does not fit into an image, with row, column and remedy.
"""
