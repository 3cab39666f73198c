"""Publishing a recorded run again: any part of it, at any pace, under orders."""
