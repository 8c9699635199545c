"""Draw one object with known truth, or ropes that lie on each other, for tests and benchmarks."""
