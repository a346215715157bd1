"""`markerbridge doctor`: listens to a source and says what is wrong with it, and what mends it."""
