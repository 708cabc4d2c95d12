"""What may be asked for: groups, choices, options (`schema`), their help, names and trust."""
