"""Additional metrics, one file each; the project's own are in framework/metrics."""
