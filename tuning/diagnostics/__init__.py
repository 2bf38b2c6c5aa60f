"""Whether a gradient is good, and which gains matter."""
