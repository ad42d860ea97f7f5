"""One passivity algorithm a file, and the table that names them."""
