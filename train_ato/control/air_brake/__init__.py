"""Policies of the air brake, and the shoe forces that the model predicts."""
