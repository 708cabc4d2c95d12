"""Additional initializers, one file each; the project's own are in framework/initialize."""
