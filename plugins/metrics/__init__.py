"""Metrics beside the project's own, which are in framework/metrics: a file each."""
