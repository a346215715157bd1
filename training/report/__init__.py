"""Reports: one HTML page with every figure and table, and the same as PNG and CSV beside it."""
