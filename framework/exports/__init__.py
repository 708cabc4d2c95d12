"""What a finished run gives away: pictures from given cameras (`render`), a fly-through (`video`),
and files that other programs open (`export`). Each is a subcommand, and only reads the run, as
`opened` reads it."""

__all__ = ["export", "opened", "render", "video"]
