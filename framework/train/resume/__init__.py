"""A training on disk: its state, the check of one that was read, and the checkpoints."""
