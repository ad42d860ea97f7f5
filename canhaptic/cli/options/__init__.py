"""The arguments of each subcommand, one file each, apart from what it does: `--help` imports nothing else."""
