"""The commands, a file each: `command` is the function, ORDER its place in `ecology --help`."""
