"""What may be chosen: groups, choices, options (`schema`), `check`, help, names and trust."""
