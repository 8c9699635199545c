"""The environments that MuJoCo simulates."""
