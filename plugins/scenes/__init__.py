"""Additional scene loaders, one file each; the project's own are in framework/scenes."""
