"""Studies over the whole: the ring once round."""
