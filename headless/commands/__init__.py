"""One module a command, each with `run(arguments, terminal)`; loaded only when that command is given."""
