"""Table images (``.fkt``): their layout, packing, reading and checking."""
