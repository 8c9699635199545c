"""Files, threads, imports and timing; nothing here depends on shapes."""
