"""Control laws, their contract, and the stack that runs them."""
