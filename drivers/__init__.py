"""Marker streams and files, in and out of bytes. The bottom floor: knows nothing above it."""
