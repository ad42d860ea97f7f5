"""One virtual environment a file, and the table that names them."""
