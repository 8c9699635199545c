"""The inner loops, one module a backend, same signatures."""
