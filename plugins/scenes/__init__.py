"""Scene loaders beside the project's own, which are in framework/scenes: a file each."""
