"""Arguments of `canhaptic schema`."""

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `schema`: none."""
