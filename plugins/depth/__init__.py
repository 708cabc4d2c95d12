"""Additional depth providers, one file each; the project's own are in framework/depth."""
