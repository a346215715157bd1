"""Pure codecs, no I/O: bytes to frames and back. Each resynchronises and counts what is bad."""
