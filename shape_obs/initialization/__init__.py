"""Find the first form of a shape that has no track yet."""
