"""The train on its line in three dimensions, from the recorded or published states of its vehicles."""
