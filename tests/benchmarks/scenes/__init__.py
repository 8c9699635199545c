"""Generate scenes with known truth; tests and measurements share them."""
