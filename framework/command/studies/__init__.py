"""Many runs at once: the ledger of a command, its failures, time and room, and its reports."""
