"""What the runs say: estimates and tests, spreads, outcomes, break-down points; numbers as text."""
