"""The subcommands of the laboratory; `canhaptic.cli.main` lists them."""
