"""When the air brake is applied, and what it does according to the model."""
