"""Safe reading and writing: size limits, atomic writes, archives, arrays, JSON, YAML, HTML pages,
paths that stay inside their folder, locks, trees of values, and the user's cache."""
