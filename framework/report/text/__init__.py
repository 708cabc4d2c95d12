"""The words of a report: its finding, tables, what is missing, where numbers come from."""
