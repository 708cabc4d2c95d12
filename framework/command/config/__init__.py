"""What may be asked for: groups, choices, options (`schema`), `check`, help, names and trust."""
