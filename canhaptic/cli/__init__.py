"""The `canhaptic` command, one file per subcommand."""
