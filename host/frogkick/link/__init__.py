"""Frames between host and robot: one layout, COBS, CRC-32."""
