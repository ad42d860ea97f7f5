"""One script a question; `make bench Q=<question>` runs it."""
