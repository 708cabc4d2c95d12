"""The pictures of a report: curves, trade-offs, stresses, sizes, renders beside the truth."""
