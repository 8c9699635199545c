"""Random, damaged and hostile input: generators, and counts of broken promises."""
