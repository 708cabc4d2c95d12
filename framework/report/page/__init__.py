"""A report written down: as markdown, and as one offline page with its assets."""
