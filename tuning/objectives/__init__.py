"""What to make small: moves from rest to rest, lines in space, stages of either."""
