"""What the robot does by itself: planar and spatial dynamics, equilibria and their stability."""
